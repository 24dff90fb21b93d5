// The foil in WebGL (three.js): all curves are one object of wide lines, so that thousands cost one draw call.

import {
  BufferAttribute,
  BufferGeometry,
  ColorManagement,
  DoubleSide,
  Group,
  LineBasicMaterial,
  LineSegments,
  LinearSRGBColorSpace,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  OrthographicCamera,
  PlaneGeometry,
  Scene,
  ShaderMaterial,
  Texture,
  Vector2,
  WebGLRenderTarget,
  WebGLRenderer,
} from "three";
import { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
import { LineSegments2 } from "three/examples/jsm/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/examples/jsm/lines/LineSegmentsGeometry.js";

import type { Scale } from "./colour";
import { type Pose, corners, middle, rotation, surfaceCorners } from "./pose";
import { type Look, type Stage, type StageInput, errorBars } from "./stage";
import { token } from "./store";

// Colours are given as they shall appear.
ColorManagement.enabled = false;

const LINE_PX = 2.6;
const CASING_PX = 5.2;
const OUTLINE_PX = 8;

export class WebglStage implements Stage {
  readonly canvas: HTMLCanvasElement;
  readonly name = "webgl";
  drawCalls = 0;
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new OrthographicCamera();
  private readonly world = new Group();
  /** What lies a little behind the lines, seen along the beam of the eye: their casing and outline. */
  private readonly behind = new Group();
  private readonly geometry = new LineSegmentsGeometry();
  private readonly lines: LineSegments2;
  private readonly casing: LineSegments2;
  private readonly outline: LineSegments2;
  private readonly bars: LineSegments;
  private readonly frame: LineSegments;
  private readonly foil: Mesh | null;
  private readonly floor: Mesh;
  private readonly eyes = new WebGLRenderTarget(1, 1, { samples: 4 });
  private readonly otherEye = new WebGLRenderTarget(1, 1, { samples: 4 });
  private readonly glasses: Mesh;
  private readonly glassesScene = new Scene();
  private readonly materials: LineMaterial[];

  /** Throws where there is no WebGL. */
  constructor(
    private readonly input: StageInput,
    redraw: () => void,
  ) {
    this.renderer = new WebGLRenderer({ antialias: true, alpha: true, powerPreference: "low-power" });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.renderer.info.autoReset = false;
    this.renderer.autoClear = false;
    this.canvas = this.renderer.domElement;
    const { model, box } = input;
    const wide = (linewidth: number, vertexColors: boolean) => new LineMaterial({ linewidth, vertexColors });
    const [line, casing, outline] = [wide(LINE_PX, true), wide(CASING_PX, false), wide(OUTLINE_PX, true)];
    outline.transparent = true;
    this.materials = [line, casing, outline];
    const ends = new Float32Array(6 * model.segmentCurve.length);
    model.segments.forEach((point, end) => ends.set(model.position.subarray(3 * point, 3 * point + 3), 3 * end));
    this.geometry.setPositions(ends);
    this.lines = new LineSegments2(this.geometry, line);
    this.casing = new LineSegments2(this.geometry, casing);
    this.outline = new LineSegments2(new LineSegmentsGeometry(), outline);
    this.outline.visible = false;
    const thin = (points: Float32Array, opacity: number) =>
      new LineSegments(
        new BufferGeometry().setAttribute("position", new BufferAttribute(points, 3)),
        new LineBasicMaterial({ transparent: true, opacity }),
      );
    this.bars = thin(errorBars(model), 0.6);
    const foil = model.report.measures.foil;
    const surfaces = "known" in foil ? surfaceCorners(box, foil.known.surfaces) : null;
    this.frame = thin(edges(corners(box), surfaces), 0.28);
    this.foil = null;
    if (surfaces) {
      const triangles = surfaces.flatMap((s) => [s[0], s[1], s[2], s[0], s[2], s[3]]).flat();
      const material = new MeshBasicMaterial({ transparent: true, opacity: 0.16, side: DoubleSide, depthWrite: false });
      const geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(Float32Array.from(triangles), 3));
      this.foil = new Mesh(geometry, material);
    }
    this.floor = this.micrograph(redraw);
    for (const object of [this.floor, this.frame, this.foil, this.bars, this.lines]) if (object) this.world.add(object);
    this.behind.add(this.casing, this.outline);
    for (const group of [this.world, this.behind]) {
      group.matrixAutoUpdate = false;
      this.scene.add(group);
    }
    this.scene.traverse((object) => (object.frustumCulled = false));
    this.glasses = new Mesh(new PlaneGeometry(2, 2), redCyan(this.eyes, this.otherEye));
    this.glasses.frustumCulled = false;
    this.glassesScene.add(this.glasses);
    this.canvas.addEventListener("webglcontextrestored", redraw);
  }

  /** The left micrograph on the far side of the box, where its points lie at mid depth. */
  private micrograph(redraw: () => void): Mesh {
    const { model, box } = this.input;
    const { frame, rectification, views } = model.report;
    const [rows, columns] = rectification.shape;
    const x = (column: number) => (column - frame.centre_px[0]) * frame.pixel;
    const y = (row: number) => (row - frame.centre_px[1]) * frame.pixel;
    const positions = Float32Array.from(views[0].corners.flatMap(([c, r]) => [x(c), y(r), box.high[2]]));
    const uv = Float32Array.from(views[0].corners.flatMap(([c, r]) => [(c + 0.5) / columns, 1 - (r + 0.5) / rows]));
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(positions, 3));
    geometry.setAttribute("uv", new BufferAttribute(uv, 2));
    geometry.setIndex([0, 1, 2, 0, 2, 3]);
    const image = new Image();
    const texture = new Texture(image);
    image.addEventListener("load", () => {
      texture.needsUpdate = true;
      redraw();
    });
    image.src = `data:image/jpeg;base64,${views[0].image}`;
    const material = new MeshBasicMaterial({ map: texture, side: DoubleSide, transparent: true, opacity: 0.55, depthWrite: false });
    const floor = new Mesh(geometry, material);
    floor.renderOrder = -1;
    return floor;
  }

  recolour(scale: Scale): void {
    const { model } = this.input;
    const colours = new Float32Array(6 * model.segmentCurve.length);
    model.segments.forEach((point, end) => {
      const colour = scale.colour(scale.value(point, model.segmentCurve[end >> 1]));
      for (let channel = 0; channel < 3; channel += 1) colours[3 * end + channel] = colour[channel] / 255;
    });
    this.geometry.setColors(colours);
    (this.casing.material as LineMaterial).color.set(token("stage"));
    for (const object of [this.bars, this.frame]) (object.material as LineBasicMaterial).color.set(token("ink"));
    if (this.foil) (this.foil.material as MeshBasicMaterial).color.set(token("accent"));
  }

  emphasise(selected: number | null, hovered: number | null): void {
    const { model } = this.input;
    const curves = [...new Set([hovered, selected])].filter((curve): curve is number => curve !== null);
    this.outline.visible = curves.length > 0;
    if (curves.length === 0) return;
    const [ends, colours]: [number[], number[]] = [[], []];
    for (const curve of curves) {
      const [r, g, b] = hexRgb(token(curve === selected ? "mark" : "muted"));
      model.segmentCurve.forEach((owner, segment) => {
        if (owner !== curve) return;
        for (const point of [model.segments[2 * segment], model.segments[2 * segment + 1]]) {
          ends.push(...model.position.subarray(3 * point, 3 * point + 3));
          colours.push(r, g, b);
        }
      });
    }
    this.outline.geometry.dispose();
    this.outline.geometry = new LineSegmentsGeometry().setPositions(ends).setColors(colours);
  }

  draw(pose: Pose, look: Look, width: number, height: number): void {
    const { renderer, camera } = this;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const size = renderer.getSize(new Vector2());
    if (size.x !== width || size.y !== height || renderer.getPixelRatio() !== ratio) {
      renderer.setPixelRatio(ratio);
      renderer.setSize(width, height, false);
    }
    const stereo = look.stereo !== "off";
    this.bars.visible = look.errorBars;
    if (this.foil) this.foil.visible = look.foil;
    this.floor.visible = look.micrograph && !stereo;
    this.casing.visible = !stereo;
    const line = this.lines.material as LineMaterial;
    if (line.vertexColors !== (look.stereo !== "anaglyph")) {
      // Glasses take the colours away: brightness alone must carry the lines.
      line.vertexColors = look.stereo !== "anaglyph";
      line.color.set(line.vertexColors ? "#ffffff" : token("ink"));
      line.needsUpdate = true;
    }
    renderer.info.reset();
    renderer.setClearColor(token("stage"), 1);
    const view = (viewPose: Pose, viewWidth: number) => {
      const [w, h] = [viewWidth / 2 / pose.zoom, height / 2 / pose.zoom];
      camera.left = -w - pose.panX / pose.zoom;
      camera.right = w - pose.panX / pose.zoom;
      camera.top = h + pose.panY / pose.zoom;
      camera.bottom = -h + pose.panY / pose.zoom;
      const reach = 4 * Math.hypot(...this.input.box.high.map((value, axis) => value - this.input.box.low[axis]));
      camera.near = -reach;
      camera.far = reach;
      camera.updateProjectionMatrix();
      this.turn(viewPose);
      // Line widths are in CSS px.
      for (const material of this.materials) material.resolution.set(viewWidth, height);
      renderer.clear();
      renderer.render(this.scene, camera);
    };
    const eye = (side: number): Pose => ({ ...pose, eye: side * look.eyeAngle });
    if (look.stereo === "pair") {
      renderer.setScissorTest(true);
      [-1, 1].forEach((side, index) => {
        renderer.setViewport((index * width) / 2, 0, width / 2, height);
        renderer.setScissor((index * width) / 2, 0, width / 2, height);
        view(eye(side), width / 2);
      });
      renderer.setScissorTest(false);
      renderer.setViewport(0, 0, width, height);
    } else if (look.stereo === "anaglyph") {
      [this.eyes, this.otherEye].forEach((target, index) => {
        target.setSize(Math.round(width * ratio), Math.round(height * ratio));
        renderer.setRenderTarget(target);
        view(eye(2 * index - 1), width);
      });
      renderer.setRenderTarget(null);
      renderer.render(this.glassesScene, camera);
    } else {
      view(pose, width);
    }
    this.drawCalls = renderer.info.render.calls;
  }

  /** Our frame (x right, y down, z away) into three's (y up, z towards the viewer), turned. */
  private turn(pose: Pose): void {
    const [right, down, away] = rotation(pose);
    const centre = middle(this.input.box);
    const shift = [right, down, away].map((row) => -row.reduce((sum, value, axis) => sum + value * centre[axis], 0));
    this.world.matrix.set(
      right[0], right[1], right[2], shift[0],
      -down[0], -down[1], -down[2], -shift[1],
      -away[0], -away[1], -away[2], -shift[2],
      0, 0, 0, 1,
    );
    const step = (1.5 * CASING_PX) / pose.zoom;
    this.behind.matrix.multiplyMatrices(new Matrix4().makeTranslation(0, 0, -step), this.world.matrix);
    for (const group of [this.world, this.behind]) group.matrixWorldNeedsUpdate = true;
  }
}

function hexRgb(hex: string): number[] {
  return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
}

/** Edges of the box, and of the surfaces where they are known. */
function edges(box: number[][], surfaces: number[][][] | null): Float32Array {
  const points: number[] = [];
  for (let a = 0; a < 8; a += 1) {
    for (const axis of [0, 1, 2]) {
      const b = a | (1 << axis);
      if (b !== a) points.push(...box[a], ...box[b]);
    }
  }
  for (const surface of surfaces ?? []) surface.forEach((corner, k) => points.push(...corner, ...surface[(k + 1) % 4]));
  return Float32Array.from(points);
}

/** Left eye red, right eye green and blue, by brightness. */
function redCyan(left: WebGLRenderTarget, right: WebGLRenderTarget): ShaderMaterial {
  return new ShaderMaterial({
    uniforms: { left: { value: left.texture }, right: { value: right.texture } },
    vertexShader: "varying vec2 at; void main() { at = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }",
    fragmentShader: `
      varying vec2 at; uniform sampler2D left; uniform sampler2D right;
      float grey(vec4 c) { return dot(c.rgb, vec3(0.2126, 0.7152, 0.0722)); }
      void main() { float r = grey(texture2D(right, at)); gl_FragColor = vec4(grey(texture2D(left, at)), r, r, 1.0); }`,
    depthTest: false,
    depthWrite: false,
  });
}
