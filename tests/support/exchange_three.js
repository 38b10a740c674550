// Renders points with given normals by three.js: each material of cases.json under each light, as float radiance.
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

const CELL = 2; // pixels: derivatives within a cell are of one normal

async function material(file) {
  if (file.endsWith(".json")) return new THREE.MaterialLoader().parse(await (await fetch(file)).json());
  if (file.endsWith(".js")) return (await import(`./${file}`)).ball;
  const gltf = await new GLTFLoader().loadAsync(file).catch(() => null);
  if (gltf !== null) return gltf.parser.getDependency("material", 0);
  throw new Error(`GLTFLoader cannot load ${file}`);
}

function cells(normals, width, height) {
  const position = [], normal = [], index = [];
  normals.forEach((n, i) => {
    const x = i % width, y = Math.floor(i / width), first = 4 * i;
    for (const [dx, dy] of [[0, 0], [1, 0], [1, 1], [0, 1]]) {
      position.push((2 * (x + dx)) / width - 1, (2 * (y + dy)) / height - 1, 0);
      normal.push(...n);
    }
    index.push(first, first + 1, first + 2, first, first + 2, first + 3);
  });
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(position, 3));
  geometry.setAttribute("normal", new THREE.Float32BufferAttribute(normal, 3));
  geometry.setIndex(index);
  return geometry;
}

async function main() {
  const { files, views, width, height } = await (await fetch("cases.json")).json();
  const renderer = new THREE.WebGLRenderer({ antialias: false });
  const target = new THREE.WebGLRenderTarget(CELL * width, CELL * height, { type: THREE.FloatType });
  const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, 0, 10);
  camera.position.z = 4;
  const found = {};
  for (const file of Object.keys(files)) {
    const surface = await material(file);
    found[file] = [];
    for (const { normals, light } of views[files[file]]) {
      const scene = new THREE.Scene(), lamp = new THREE.DirectionalLight(0xffffff, Math.PI);
      lamp.position.set(...light);
      scene.add(lamp, new THREE.Mesh(cells(normals, width, height), surface));
      renderer.setRenderTarget(target);
      renderer.render(scene, camera);
      const pixels = new Float32Array(4 * CELL * width * CELL * height), image = [];
      renderer.readRenderTargetPixels(target, 0, 0, CELL * width, CELL * height, pixels);
      for (let i = 0; i < normals.length; i++) {
        const at = 4 * (CELL * Math.floor(i / width) * CELL * width + CELL * (i % width));
        image.push(Array.from(pixels.slice(at, at + 3)));
      }
      found[file].push(image);
    }
  }
  return JSON.stringify(found);
}

main().catch((error) => `failed: ${error.stack}`).then((text) => fetch("result", { method: "POST", body: text }));
