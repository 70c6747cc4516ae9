// Prints world positions of joints as three.js plays a .glb, .gltf or .bvh: FILE UNIT FPS FRAMES NAME...
import fs from 'fs';
import * as THREE from 'three';
import { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';
import { BVHLoader } from 'three/examples/jsm/loaders/BVHLoader.js';

globalThis.self = globalThis;
globalThis.ProgressEvent ??= class {};
const [path, unit, fps, frames, ...names] = process.argv.slice(2);
const data = fs.readFileSync(path);
let root, clip, extras;
if (!path.endsWith('.bvh')) {
  const text = path.endsWith('.gltf');
  const bytes = text ? data.toString('utf8') : data.buffer.slice(data.byteOffset, data.byteOffset + data.length);
  const gltf = await new Promise((resolve, reject) => new GLTFLoader().parse(bytes, '', resolve, reject));
  [root, clip, extras] = [gltf.scene, gltf.animations[0], gltf.asset.extras];
} else {
  const bvh = new BVHLoader().parse(data.toString('utf8'));
  [root, clip] = [bvh.skeleton.bones[0], bvh.clip];
}
const joints = names.map((name) => root.getObjectByName(THREE.PropertyBinding.sanitizeNodeName(name)));
const mixer = new THREE.AnimationMixer(root);
const action = mixer.clipAction(clip).setLoop(THREE.LoopOnce);
action.clampWhenFinished = true;
action.play();
const positions = [];
for (let frame = 0; frame < Number(frames); frame++) {
  mixer.setTime(Math.min(frame / Number(fps), clip.duration));
  root.updateMatrixWorld(true);
  for (const joint of joints) positions.push(...joint.getWorldPosition(new THREE.Vector3()).multiplyScalar(Number(unit)));
}
console.log(JSON.stringify({ positions, extras }));
