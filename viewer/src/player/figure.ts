/** One take as it stands in the scene: the mannequin, its contact shadows, and what can be laid over it. */

import * as THREE from "three";
import type { Skeleton } from "../skeleton";
import type { Pose, Take } from "../take";
import { mannequin, type Part, type Tone } from "./body";
import type { Theme } from "./theme";
import { Trail } from "./trail";

export interface Overlays {
  skeleton: boolean;
  contacts: boolean;
  trail: boolean;
}

const TONES: Tone[] = ["shell", "core", "left", "right", "face"];

export class Figure {
  readonly group = new THREE.Group();
  readonly pose: Pose;
  private readonly limbs: Limb[];
  private readonly materials: Record<"matte" | "glossy", THREE.Material>;
  private readonly blobs: Blobs;
  private readonly rods: Rods;
  private readonly soles: THREE.InstancedMesh;
  private readonly trail = new Trail();
  private readonly feet: readonly number[];
  private overlays: Overlays = { skeleton: false, contacts: false, trail: false };

  /** `coarse`: a body of fewer triangles. */
  constructor(
    readonly take: Take,
    coarse = false,
  ) {
    const { skeleton } = take;
    this.pose = { positions: new Float32Array(3 * skeleton.length), rotations: new Float32Array(4 * skeleton.length) };
    this.feet = skeleton.feet;
    this.materials = {
      matte: new THREE.MeshLambertMaterial({ vertexColors: true }),
      glossy: new THREE.MeshPhongMaterial({ vertexColors: true, specular: 0x8899aa, shininess: 60 }),
    };
    this.limbs = limbsOf(skeleton, this.materials, coarse);
    this.blobs = new Blobs(this.feet.length > 0 ? 5 : 1);
    this.rods = new Rods(skeleton);
    this.soles = new THREE.InstancedMesh(
      new THREE.RingGeometry(0.045, 0.068, 40).rotateX(-Math.PI / 2),
      new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.95, depthWrite: false }),
      Math.max(1, this.feet.length),
    );
    this.soles.frustumCulled = false;
    this.soles.renderOrder = 3;
    this.group.add(...this.limbs.map(({ mesh }) => mesh), this.blobs.mesh, this.rods.group, this.soles, this.trail.group);
    this.show(this.overlays);
  }

  /** Colours of a theme. */
  paint(theme: Theme): void {
    const colours = TONES.map((tone) => new THREE.Color(theme[tone]));
    for (const { mesh, tones } of this.limbs) {
      const painted = mesh.geometry.getAttribute("color") as THREE.BufferAttribute;
      tones.forEach((tone, k) => painted.setXYZ(k, colours[tone].r, colours[tone].g, colours[tone].b));
      painted.needsUpdate = true;
    }
    this.blobs.material.uniforms.strength.value = 1.5 * theme.shadow;
    this.rods.paint(theme);
    this.trail.paint(theme);
    for (let k = 0; k < this.feet.length; k++) this.soles.setColorAt(k, new THREE.Color(k < 2 ? theme.left : theme.right));
    if (this.soles.instanceColor) this.soles.instanceColor.needsUpdate = true;
  }

  /** What is laid over the body. */
  show(overlays: Overlays): void {
    this.overlays = { ...overlays };
    this.rods.group.visible = overlays.skeleton;
    this.soles.visible = overlays.contacts && this.feet.length > 0;
    this.trail.group.visible = overlays.trail;
    for (const material of Object.values(this.materials)) {
      material.transparent = overlays.skeleton;
      material.opacity = overlays.skeleton ? 0.42 : 1;
      material.needsUpdate = true;
    }
  }

  /** Move everything to a frame of the take, which may lie between two. */
  update(frame: number): void {
    const { positions, rotations } = this.take.pose(frame, this.pose);
    for (const { mesh, joint } of this.limbs) {
      place.fromArray(positions, 3 * joint);
      mesh.matrix.compose(place, turn.fromArray(rotations, 4 * joint), one);
    }
    this.blobs.update(positions, this.feet);
    if (this.overlays.skeleton) this.rods.update(positions);
    if (this.overlays.contacts) this.markContacts(frame);
    if (this.overlays.trail) this.trail.update(this.take, frame);
  }

  private markContacts(frame: number): void {
    this.take.contacts(frame).forEach((planted, k) => {
      const j = this.feet[k];
      const { positions } = this.pose;
      matrix.makeScale(planted ? 1 : 0, 1, planted ? 1 : 0).setPosition(positions[3 * j], 0.006, positions[3 * j + 2]);
      this.soles.setMatrixAt(k, matrix);
    });
    this.soles.instanceMatrix.needsUpdate = true;
  }

  dispose(): void {
    for (const { mesh } of this.limbs) mesh.geometry.dispose();
    for (const material of Object.values(this.materials)) material.dispose();
    this.blobs.dispose();
    this.rods.dispose();
    this.soles.geometry.dispose();
    (this.soles.material as THREE.Material).dispose();
    this.soles.dispose();
    this.trail.dispose();
  }
}

const place = new THREE.Vector3();
const turn = new THREE.Quaternion();
const one = new THREE.Vector3(1, 1, 1);
const matrix = new THREE.Matrix4();

/** What moves with one joint. Rigid, so that a graphics card, or a processor in its place, has little to do. */
interface Limb {
  joint: number;
  mesh: THREE.Mesh;
  /** Index in TONES of each vertex. */
  tones: Uint8Array;
}

function limbsOf(skeleton: Skeleton, materials: Record<"matte" | "glossy", THREE.Material>, coarse: boolean): Limb[] {
  const together = new Map<string, Part[]>();
  for (const part of mannequin(skeleton, coarse)) {
    const key = `${part.joint} ${part.tone === "face"}`;
    together.set(key, [...(together.get(key) ?? []), part]);
  }
  return [...together.values()].map((parts) => {
    const positions = parts.flatMap((part) => part.positions);
    const tones = parts.flatMap((part) => Array<number>(part.positions.length / 3).fill(TONES.indexOf(part.tone)));
    const index: number[] = [];
    let base = 0;
    for (const part of parts) {
      for (const corner of part.triangles) index.push(base + corner);
      base += part.positions.length / 3;
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(Float32Array.from(positions), 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(positions.length), 3));
    geometry.setIndex(index);
    geometry.computeVertexNormals();
    const face = parts[0].tone === "face";
    const mesh = new THREE.Mesh(geometry, face ? materials.glossy : materials.matte);
    mesh.matrixAutoUpdate = false;
    mesh.castShadow = !face;
    mesh.receiveShadow = true;
    return { joint: parts[0].joint, mesh, tones: Uint8Array.from(tones) };
  });
}

/** Soft dark spots where the body comes near the ground: the key light's shadow alone lets a figure float. */
class Blobs {
  readonly mesh: THREE.InstancedMesh;
  readonly material: THREE.ShaderMaterial;
  private readonly darkness: THREE.InstancedBufferAttribute;

  constructor(private readonly count: number) {
    const geometry = new THREE.PlaneGeometry(2, 2).rotateX(-Math.PI / 2);
    this.darkness = new THREE.InstancedBufferAttribute(new Float32Array(count), 1);
    geometry.setAttribute("darkness", this.darkness);
    this.material = new THREE.ShaderMaterial({
      transparent: true,
      depthWrite: false,
      uniforms: { strength: { value: 0.5 } },
      vertexShader: `attribute float darkness; varying vec2 spot; varying float dark;
        void main() { spot = position.xz; dark = darkness;
          gl_Position = projectionMatrix * modelViewMatrix * instanceMatrix * vec4(position, 1.0); }`,
      fragmentShader: `uniform float strength; varying vec2 spot; varying float dark;
        void main() { float r = 1.0 - min(1.0, dot(spot, spot));
          gl_FragColor = vec4(0.03, 0.04, 0.07, strength * dark * r * r); }`,
    });
    this.mesh = new THREE.InstancedMesh(geometry, this.material, count);
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = 1;
  }

  update(positions: Float32Array, feet: readonly number[]): void {
    for (let k = 0; k < this.count; k++) {
      const j = k < feet.length ? feet[k] : 0;
      const height = Math.max(0, positions[3 * j + 1]);
      const [radius, reach, most] = k < feet.length ? [0.15, 0.3, 0.75] : [0.42, 1.5, 0.5];
      const near = Math.max(0, 1 - height / reach);
      const size = radius * (1 + 0.6 * (1 - near));
      matrix.makeScale(size, 1, size).setPosition(positions[3 * j], 0.003, positions[3 * j + 2]);
      this.mesh.setMatrixAt(k, matrix);
      this.darkness.setX(k, most * near * near);
    }
    this.mesh.instanceMatrix.needsUpdate = this.darkness.needsUpdate = true;
  }

  dispose(): void {
    this.mesh.geometry.dispose();
    this.material.dispose();
    this.mesh.dispose();
  }
}

/** Joints and the bones between them, seen through the body. */
class Rods {
  readonly group = new THREE.Group();
  private readonly rods: THREE.InstancedMesh;
  private readonly balls: THREE.InstancedMesh;
  private readonly material = new THREE.MeshBasicMaterial({ depthTest: false, transparent: true, opacity: 0.95 });
  private readonly pairs: [number, number][];

  constructor(private readonly skeleton: Skeleton) {
    this.pairs = skeleton.parents.flatMap((parent, j) => (parent < 0 ? [] : [[parent, j] as [number, number]]));
    // From the origin to one along y.
    const rod = new THREE.CylinderGeometry(0.008, 0.008, 1, 8, 1).translate(0, 0.5, 0);
    this.rods = new THREE.InstancedMesh(rod, this.material, Math.max(1, this.pairs.length));
    this.balls = new THREE.InstancedMesh(new THREE.SphereGeometry(0.018, 14, 10), this.material, skeleton.length);
    for (const mesh of [this.rods, this.balls]) {
      mesh.frustumCulled = false;
      mesh.renderOrder = 4;
      this.group.add(mesh);
    }
  }

  paint(theme: Theme): void {
    const colour = (j: number) => {
      const name = this.skeleton.joints[j].toLowerCase();
      const tone = /left|_l$|^l_/.test(name) ? theme.left : /right|_r$|^r_/.test(name) ? theme.right : theme.trail;
      return new THREE.Color(tone);
    };
    this.pairs.forEach(([, j], k) => this.rods.setColorAt(k, colour(j)));
    this.skeleton.joints.forEach((_, j) => this.balls.setColorAt(j, colour(j)));
    for (const mesh of [this.rods, this.balls]) if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
  }

  update(positions: Float32Array): void {
    this.pairs.forEach(([a, b], k) => {
      place.fromArray(positions, 3 * b);
      start.fromArray(positions, 3 * a);
      place.sub(start);
      const long = place.length();
      turn.setFromUnitVectors(up, long > 1e-6 ? place.divideScalar(long) : up);
      this.rods.setMatrixAt(k, matrix.compose(start, turn, size.set(1, Math.max(long, 1e-6), 1)));
    });
    for (let j = 0; j < this.skeleton.length; j++) {
      this.balls.setMatrixAt(j, matrix.makeTranslation(place.fromArray(positions, 3 * j)));
    }
    this.rods.instanceMatrix.needsUpdate = this.balls.instanceMatrix.needsUpdate = true;
  }

  dispose(): void {
    for (const mesh of [this.rods, this.balls]) {
      mesh.geometry.dispose();
      mesh.dispose();
    }
    this.material.dispose();
  }
}

const start = new THREE.Vector3();
const size = new THREE.Vector3();
const up = new THREE.Vector3(0, 1, 0);
