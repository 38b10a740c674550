// Renders mesh files by three.js under each light of cases.json, as float radiance, with zoom x zoom pixels a texel; posts
// the middle one of each, and console messages.
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { MTLLoader } from "three/addons/loaders/MTLLoader.js";
import { OBJLoader } from "three/addons/loaders/OBJLoader.js";
import { post, rendererOf, said } from "./three_renderer.js";

async function load(file) {
  if (file.endsWith(".json")) return new THREE.ObjectLoader().loadAsync(file);
  if (!file.endsWith(".obj")) return (await new GLTFLoader().loadAsync(file)).scene;
  const materials = await new MTLLoader().loadAsync(file.replace(".obj", ".mtl"));
  return new OBJLoader().setMaterials(materials).loadAsync(file);
}

const textures = (material) => Object.values(material).filter((value) => value && value.isTexture);

async function main() {
  const { files, lights, zoom, rows, columns, extent } = await (await fetch("cases.json")).json();
  const width = zoom * columns, height = zoom * rows, middle = Math.floor(zoom / 2);
  const render = rendererOf(width, height, extent), found = {};
  for (const file of files) {
    const manager = new Promise((done) => (THREE.DefaultLoadingManager.onLoad = done));
    const model = await load(file);
    if (!/gl(b|tf)$/.test(file)) await manager; // the pictures of its materials
    model.traverse((part) => part.material && textures(part.material).forEach((of) => {
      of.magFilter = of.minFilter = THREE.NearestFilter; // a pixel shows its own texel
      of.generateMipmaps = false;
      of.needsUpdate = true;
    }));
    found[file] = [];
    for (const light of lights) {
      const pixels = render(model, light);
      found[file].push(Array.from({ length: 4 * rows * columns }, (_, i) => {
        const texel = Math.floor(i / 4), row = zoom * Math.floor(texel / columns), column = zoom * (texel % columns);
        return pixels[4 * ((row + middle) * width + column + middle) + (i % 4)];
      }));
    }
  }
  return JSON.stringify({ found, said });
}

post(main());
