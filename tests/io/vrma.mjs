// Prints what pixiv's loader of VRM animations reads in a .vrma: rotations of each bone, the path of the hips, the times.
import fs from 'fs';
import { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';
import { VRMAnimationLoaderPlugin } from '@pixiv/three-vrm-animation';

globalThis.self = globalThis;
const data = fs.readFileSync(process.argv[2]);
const bytes = data.buffer.slice(data.byteOffset, data.byteOffset + data.length);
const loader = new GLTFLoader().register((parser) => new VRMAnimationLoaderPlugin(parser));
const gltf = await new Promise((resolve, reject) => loader.parse(bytes, '', resolve, reject));
const [animation] = gltf.userData.vrmAnimations;
const tracks = [...animation.humanoidTracks.rotation].map(([bone, track]) => [bone, [...track.values]]);
const hips = animation.humanoidTracks.translation.get('hips');
console.log(JSON.stringify({
  rotations: Object.fromEntries(tracks),
  hips: [...hips.values],
  times: [...hips.times],
  rest: animation.restHipsPosition.toArray(),
}));
