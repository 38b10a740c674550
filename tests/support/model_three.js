// Renders models by three.js as it loads them, filters included, under a light of pi along -z; posts linear floats.
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { post, rendererOf, said } from "./three_renderer.js";

async function main() {
  const { files, width, height, extent } = await (await fetch("cases.json")).json();
  const render = rendererOf(width, height, extent), found = {};
  for (const file of files) found[file] = Array.from(render((await new GLTFLoader().loadAsync(file)).scene, [0, 0, 1]));
  return JSON.stringify({ found, said });
}

post(main());
