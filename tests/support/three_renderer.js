// What renders a scene by three.js seen along -z, `extent` high, as linear floats.
import * as THREE from "three";

export const said = [];
for (const kind of ["warn", "error", "log"]) console[kind] = (...words) => said.push(words.join(" "));

export function rendererOf(width, height, extent) {
  const renderer = new THREE.WebGLRenderer({ antialias: false });
  const target = new THREE.WebGLRenderTarget(width, height, { type: THREE.FloatType });
  const half = extent / 2, camera = new THREE.OrthographicCamera(-half * width / height, half * width / height, half, -half, 0, 10);
  camera.position.z = 4;
  renderer.setRenderTarget(target);
  renderer.setClearColor(0, 0);
  return (model, light) => { // a model under a light of pi from a place: the pixels, lowest row first
    const scene = new THREE.Scene(), lamp = new THREE.DirectionalLight(0xffffff, Math.PI);
    lamp.position.set(...light);
    scene.add(lamp, model);
    renderer.render(scene, camera);
    const pixels = new Float32Array(4 * width * height);
    renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
    return pixels;
  };
}

export const post = (found) => found.catch((error) => `failed: ${error.stack}`).then((text) => fetch("result", { method: "POST", body: text }));
