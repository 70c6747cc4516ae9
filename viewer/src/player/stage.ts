/** The scene around the figures: light, ground, fog, and the picture it gives. */

import * as THREE from "three";
import { openSurface } from "./surface";
import { type Theme, type ThemeName, THEMES } from "./theme";

const GROUND = 60;

export class Stage {
  readonly scene = new THREE.Scene();
  readonly camera = new THREE.PerspectiveCamera(32, 1, 0.05, 200);
  readonly renderer: THREE.WebGLRenderer;
  /** Drawn by a processor in a graphics card's place. */
  readonly software: boolean;
  private pixels = 1;
  private readonly hemisphere = new THREE.HemisphereLight();
  private readonly key = new THREE.DirectionalLight();
  private readonly rim = new THREE.DirectionalLight();
  private readonly shade = new THREE.Mesh(new THREE.PlaneGeometry(1, 1), new THREE.ShadowMaterial());
  private readonly grid = new THREE.Mesh(new THREE.PlaneGeometry(GROUND, GROUND), gridMaterial());
  private readonly fog = new THREE.Fog(0, 9, 30);

  constructor(canvas: HTMLCanvasElement) {
    ({ renderer: this.renderer, software: this.software } = openSurface(canvas));
    this.pixels = this.full;
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.key.castShadow = true;
    this.key.shadow.mapSize.setScalar(this.software ? 512 : 1024);
    this.key.shadow.radius = 5;
    this.key.shadow.bias = -0.0004;
    this.key.shadow.normalBias = 0.012;
    for (const mesh of [this.shade, this.grid]) mesh.rotation.x = -Math.PI / 2;
    this.shade.receiveShadow = true;
    this.shade.renderOrder = 0;
    this.grid.renderOrder = -1;
    this.shade.position.y = 0.001;
    this.scene.fog = this.fog;
    this.scene.add(this.hemisphere, this.key, this.key.target, this.rim, this.rim.target, this.shade, this.grid);
  }

  setTheme(name: ThemeName): Theme {
    const theme = THEMES[name];
    this.scene.background = new THREE.Color(theme.background);
    this.fog.color.set(theme.background);
    this.key.color.set(theme.sun);
    this.hemisphere.color.set(theme.sky);
    this.hemisphere.groundColor.set(theme.earth);
    this.hemisphere.intensity = theme.hemisphere;
    this.key.intensity = theme.key;
    this.rim.intensity = theme.rim;
    (this.shade.material as THREE.ShadowMaterial).opacity = theme.shadow;
    const { uniforms } = this.grid.material as THREE.ShaderMaterial;
    uniforms.colour.value.set(theme.line);
    uniforms.opacity.value = theme.lineOpacity;
    uniforms.pool.value.set(theme.pool);
    return theme;
  }

  /** Light and ground around a point, for figures within `radius` of it. */
  follow(x: number, z: number, radius: number): void {
    const reach = radius + 1.6;
    const { camera } = this.key.shadow;
    if (camera.right !== reach) {
      [camera.left, camera.right, camera.bottom, camera.top] = [-reach, reach, -reach, reach];
      [camera.near, camera.far] = [0.5, 18 + 2 * reach];
      camera.updateProjectionMatrix();
    }
    // No larger than the shadow can be: every pixel of it is paid for.
    this.shade.scale.set(2.4 * reach, 2.4 * reach, 1);
    this.key.target.position.set(x, 0.8, z);
    this.key.position.set(x + 3.4, 7.2, z + 4.6);
    this.rim.target.position.set(x, 1, z);
    this.rim.position.set(x - 4, 4.5, z - 5);
    this.shade.position.x = this.grid.position.x = x;
    this.shade.position.z = this.grid.position.z = z;
    (this.grid.material as THREE.ShaderMaterial).uniforms.centre.value.set(x, z);
    (this.grid.material as THREE.ShaderMaterial).uniforms.reach.value = 6.5 + 1.6 * radius;
    this.fog.near = 9 + 2 * radius;
    this.fog.far = 30 + 4 * radius;
  }

  /** Pixels of the screen to a CSS pixel, as far as anybody sees them. */
  get screen(): number {
    return Math.min(devicePixelRatio, 2);
  }

  /** Pixels to a CSS pixel of a still picture; in software they smooth its edges too. */
  get full(): number {
    return this.software ? Math.max(this.screen, 1.6) : this.screen;
  }

  /** Pixels to a CSS pixel that are drawn. */
  get ratio(): number {
    return this.pixels;
  }

  set ratio(value: number) {
    if (value === this.pixels) return;
    this.pixels = value;
    this.renderer.setPixelRatio(value);
  }

  /** Size of the picture in CSS pixels. */
  resize(width: number, height: number): void {
    this.renderer.setPixelRatio(this.pixels);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
  }

  render(): void {
    this.renderer.render(this.scene, this.camera);
  }

  dispose(): void {
    for (const mesh of [this.shade, this.grid]) {
      mesh.geometry.dispose();
      (mesh.material as THREE.Material).dispose();
    }
    this.key.shadow.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }
}

/** Lines every half metre, stronger every metre, smooth at any distance, fading out around the figures. */
function gridMaterial(): THREE.ShaderMaterial {
  return new THREE.ShaderMaterial({
    transparent: true,
    depthWrite: false,
    uniforms: {
      colour: { value: new THREE.Color() },
      opacity: { value: 0.3 },
      centre: { value: new THREE.Vector2() },
      reach: { value: 8 },
      pool: { value: new THREE.Color() },
    },
    vertexShader: `varying vec2 spot;
      void main() { vec4 world = modelMatrix * vec4(position, 1.0); spot = world.xz;
        gl_Position = projectionMatrix * viewMatrix * world; }`,
    fragmentShader: `uniform vec3 colour, pool; uniform float opacity; uniform vec2 centre; uniform float reach; varying vec2 spot;
      float lines(vec2 at, float width) {
        vec2 pixel = fwidth(at);
        vec2 away = abs(fract(at - 0.5) - 0.5);
        vec2 near = 1.0 - smoothstep(vec2(width) - pixel, vec2(width) + pixel, away);
        // Where a pixel holds many lines, their mean.
        near = mix(near, vec2(2.0 * width), smoothstep(0.2, 0.6, pixel));
        return max(near.x, near.y); }
      void main() {
        float shown = max(lines(spot, 0.006), 0.42 * lines(spot * 2.0, 0.008));
        float away = length(spot - centre) / reach;
        float fade = 1.0 - smoothstep(0.15, 1.0, away);
        float line = opacity * shown * fade * fade;
        // Light on the ground around the figures, under the lines.
        float lit = exp(-5.0 * away * away);
        float cover = line + lit * (1.0 - line);
        gl_FragColor = vec4(mix(pool, colour, line / max(cover, 1e-4)), cover);
        #include <colorspace_fragment>
      }`,
  });
}
