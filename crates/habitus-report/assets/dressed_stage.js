// A stage on which a dressed person plays: drawing, camera, frames and layers. Where the clothing of a frame comes from is
// the subclass's: components from a server (dressing_room.js) or meshes in the page (dressed_report.js).

const element = (id) => document.getElementById(id);
const all = (selector) => [...document.querySelectorAll(selector)];
const layers = { clothing: true, body: true, clearance: false, penetration: false, before: false, follow: true };
const LAYER_KEYS = { c: "clothing", b: "body", h: "clearance", p: "penetration", u: "before", f: "follow" };
const state = { frame: 0, isPlaying: true, framesDrawn: 0 };

const CLOTHING_VERTEX = `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 4) in float clearance;
uniform mat4 view, projection;
out vec3 viewNormal, viewPosition;
out float heat, height;
void main() {
  vec4 seen = view * vec4(position, 1.0);
  viewNormal = mat3(view) * normal;
  viewPosition = seen.xyz;
  heat = clearance;
  height = position.y;
  gl_Position = projection * seen;
}`;

const CLOTHING_FRAGMENT = `#version 300 es
precision highp float;
in vec3 viewNormal, viewPosition;
in float heat, height;
uniform vec3 color, up;
uniform vec2 heatRange;
uniform float showsHeat, showsPenetration;
uniform sampler2D heatColors;
out vec4 pixel;
${STUDIO}
void main() {
  vec3 towardEye = normalize(-viewPosition);
  vec3 n = normalize(viewNormal);
  // A sheet has two sides; which one is seen is told by the light, not by the winding.
  if (dot(n, towardEye) < 0.0) n = -n;
  vec3 albedo = color;
  float share = (heat - heatRange.x) / (heatRange.y - heatRange.x);
  if (showsHeat > 0.5) albedo = texture(heatColors, vec2(clamp(share, 0.002, 0.998), 0.5)).rgb;
  if (showsPenetration > 0.5) albedo = mix(albedo, vec3(0.86, 0.08, 0.05), smoothstep(0.0, -2.0, heat));
  pixel = vec4(toScreen(lit(albedo, n, towardEye, up)), 1.0);
}`;

/** The renderer of reports with a garment that is uploaded anew each frame. */
class DressedRenderer extends Renderer {
  constructor(canvas, body, clothing, heat) {
    super(canvas, body, heat);
    const gl = this.gl;
    this.programs.clothing = this.program(CLOTHING_VERTEX, CLOTHING_FRAGMENT);
    this.programs.clothingShadow = this.program(CLOTHING_VERTEX, SHADOW_FRAGMENT);
    this.buffers = { position: gl.createBuffer(), normal: gl.createBuffer(), clearance: gl.createBuffer() };
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    this.attribute(0, this.buffers.position, clothing.positions, 3, gl.FLOAT, false);
    this.attribute(1, this.buffers.normal, clothing.normals, 3, gl.FLOAT, false);
    this.attribute(4, this.buffers.clearance, new Int8Array(clothing.vertexCount), 1, gl.BYTE, false);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, clothing.faces, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    const indexType = clothing.faces instanceof Uint16Array ? gl.UNSIGNED_SHORT : gl.UNSIGNED_INT;
    this.clothingMesh = { array, count: clothing.faces.length, indexType, vertexCount: clothing.vertexCount };
  }

  upload(buffer, values) {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
  }

  setClothing(clothing, clearance) {
    this.upload(this.buffers.position, clothing.positions);
    this.upload(this.buffers.normal, clothing.normals);
    if (clearance) this.upload(this.buffers.clearance, clearance);
  }

  drawCapture(common, { colors, layers }) {
    this.gl.bindTexture(this.gl.TEXTURE_2D, this.heatTexture);
    const marks = { showsHeat: layers.clearance ? 1 : 0, showsPenetration: layers.penetration ? 1 : 0 };
    this.use("clothing", { ...common, ...marks, color: colors.clothing, heatRange: this.heatRange });
    this.drawMesh(this.clothingMesh);
  }

  drawShadow(scene) {
    super.drawShadow({ ...scene, layers: { ...scene.layers, capture: false } });
  }

  show(scene, bones) {
    this.frame = { bones };
    this.captureMesh = this.clothingMesh;
    this.draw({ ...scene, lines: [], dots: [], layers: { ...scene.layers, capture: scene.layers.clothing, heat: false } });
  }
}

/** Area-weighted; the shader brings them to unit length. */
const turnNormals = ({ positions, normals, faces }) => {
  normals.fill(0);
  for (let f = 0; f < faces.length; f += 3) {
    const a = faces[f] * 3, b = faces[f + 1] * 3, c = faces[f + 2] * 3;
    const ux = positions[b] - positions[a], uy = positions[b + 1] - positions[a + 1], uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a], vy = positions[c + 1] - positions[a + 1], vz = positions[c + 2] - positions[a + 2];
    const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
    normals[a] += nx; normals[a + 1] += ny; normals[a + 2] += nz;
    normals[b] += nx; normals[b + 1] += ny; normals[b + 2] += nz;
    normals[c] += nx; normals[c + 1] += ny; normals[c + 2] += nz;
  }
};

/** Faces and bones of the body; its shape at rest comes with a sequence. */
const readDressedBody = ({ vertexCount, faceCount, boneCount }, reader) => {
  const faces = reader.faces(faceCount, vertexCount);
  const weights = reader.take(Uint8Array, vertexCount * 4);
  const bones = reader.take(Uint8Array, vertexCount * 4);
  const positions = new Float32Array(vertexCount * 3);
  return { vertexCount, faces, weights, bones, positions, joints: { length: boneCount }, normals: new Int8Array(vertexCount * 4) };
};

/** A dressed person: subclasses say in `poseClothing` where the clothing of a frame is. */
class DressedStage {
  constructor(room, body, clothing) {
    this.room = room;
    this.body = body;
    this.clothing = clothing;
    this.canvas = element("canvas");
    this.renderer = new DressedRenderer(this.canvas, body, clothing, { range: room.heatRange, colors: room.heatColors });
    this.camera = new OrbitCamera(this.canvas, 1.1, () => this.request());
    this.camera.yaw = 0.45;
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.readColors());
    this.readColors();
  }

  readColors() {
    const style = getComputedStyle(document.documentElement);
    const color = (name) => style.getPropertyValue(name).trim().split(/\s+/).map((value) => Number(value) / 255);
    this.colors = {
      background: color("--view-background"), body: color("--view-body"), clothing: color("--view-capture"), ink: color("--view-ink"),
      shadow: Number(style.getPropertyValue("--view-shadow").trim()),
    };
    this.request();
  }

  resize() {
    const ratio = Math.min(2, devicePixelRatio || 1);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((side) => Math.max(1, Math.round(side * ratio)));
    if (width !== this.canvas.width || height !== this.canvas.height) Object.assign(this.canvas, { width, height });
    // At once: a canvas of another size is empty until it is drawn.
    this.draw();
  }

  setSequence(sequence) {
    this.sequence = sequence;
    this.body.positions = sequence.rest;
    this.body.normals = vertexNormals(sequence.rest, this.body.faces);
    this.renderer.setBody(this.body);
    let low = Infinity, high = -Infinity;
    for (let i = 1; i < sequence.rest.length; i += 3) [low, high] = [Math.min(low, sequence.rest[i]), Math.max(high, sequence.rest[i])];
    this.height = high - low;
    this.camera.radius = this.height * 0.63;
    element("scrubber").max = sequence.frameCount - 1;
    state.frame = Math.min(state.frame, sequence.frameCount - 1);
    this.shown = null;
    this.showPenetration();
    this.request();
  }

  bonesOf(frame) {
    const size = this.room.body.boneCount * 12;
    return this.sequence.bones.subarray(frame * size, (frame + 1) * size);
  }

  /** Signed distances from the skin of all frames, millimetres; null: unknown. */
  clearances() {
    return this.sequence.clearance;
  }

  clearanceOf(frame) {
    const size = this.clothing.vertexCount;
    return this.clearances()?.subarray(frame * size, (frame + 1) * size);
  }

  showPenetration() {
    const note = element("penetration-note");
    const clearance = this.clearances();
    note.replaceChildren();
    if (!clearance || !(layers.penetration || layers.clearance)) return;
    let [inside, deepest] = [0, 0];
    for (const value of clearance) {
      if (value < 0) inside++;
      deepest = Math.min(deepest, value);
    }
    const text = `${((100 * inside) / clearance.length).toFixed(1)} % of the cloth inside the body, ${-deepest} mm at most`;
    note.append(Object.assign(document.createElement("span"), { textContent: text }));
  }

  request() {
    this.pending ??= requestAnimationFrame(() => this.draw());
  }

  draw() {
    if (this.pending) cancelAnimationFrame(this.pending);
    this.pending = null;
    if (!this.sequence) return;
    const { frame } = state;
    const bones = this.bonesOf(frame);
    if (this.shown !== frame) {
      this.poseClothing(frame, bones);
      this.renderer.setClothing(this.clothing, this.clearanceOf(frame));
      this.shown = frame;
    }
    const root = moved(layers.follow ? bones : this.bonesOf(0), 0, [...this.sequence.rest.subarray(3 * this.room.body.rootVertex, 3 * this.room.body.rootVertex + 3)]);
    const target = [root[0], this.height * 0.53, root[2]];
    const { eye, view, projection } = this.camera.matrices(target);
    const floor = eye[1] > 0.02 ? [root[0], 0, root[2]] : null;
    this.renderer.show({ view, projection, floor, layers, colors: this.colors }, bones);
    element("scrubber").value = frame;
    element("frame-label").textContent = `${frame + 1} / ${this.sequence.frameCount}`;
  }

  look(name) {
    const bones = this.bonesOf(state.frame);
    const facing = Math.atan2(bones[2], bones[10]);
    const yaws = { front: facing, side: facing + Math.PI / 2, back: facing + Math.PI };
    if (name === "reset") this.camera.fit();
    else this.camera.turn(yaws[name], 0.05);
  }

  snapshot() {
    this.draw();
    const { gl, canvas } = this.renderer;
    const pixels = new Uint8Array(canvas.width * canvas.height * 4);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return pixels;
  }

  /** What else a switched layer asks for. */
  onLayer() {}
}

let stage = null;

const setLayer = (name, isOn = !layers[name]) => {
  layers[name] = isOn;
  document.querySelector(`[data-layer="${name}"]`)?.setAttribute("aria-pressed", String(isOn));
  element("legend").hidden = !layers.clearance;
  stage.onLayer(name);
  if (stage.sequence) stage.showPenetration();
  stage.request();
};

const showFrame = (frame) => {
  const count = stage.sequence?.frameCount ?? 1;
  state.frame = ((frame % count) + count) % count;
  stage.request();
};

const setPlaying = (isPlaying) => {
  state.isPlaying = isPlaying;
  element("play").classList.toggle("is-playing", isPlaying);
  element("play").setAttribute("aria-label", isPlaying ? "Pause" : "Play");
};

/** Plays and counts: frames that were dressed and drawn, by the seconds that it took. */
const play = () => {
  let last = performance.now();
  let passed = 0;
  let [drawn, since] = [0, last];
  const tick = (now) => {
    requestAnimationFrame(tick);
    const span = 1000 / stage.room.framesPerSecond;
    passed = Math.min(passed + now - last, 4 * span);
    last = now;
    if (!state.isPlaying || !stage.sequence || passed < span) return;
    const steps = Math.floor(passed / span);
    passed -= steps * span;
    showFrame(state.frame + steps);
    stage.draw();
    drawn++;
    state.framesDrawn++;
    if (now - since > 1000) {
      const rate = element("rate");
      if (rate) rate.textContent = `${Math.round((1000 * drawn) / (now - since))} frames/s`;
      [drawn, since] = [0, now];
    }
  };
  requestAnimationFrame(tick);
};

const drawLegend = (room) => {
  const [low, high] = room.heatRange;
  const bar = element("legend-bar").getContext("2d");
  room.heatColors.forEach((color, i) => {
    bar.fillStyle = `rgb(${color.join(" ")})`;
    bar.fillRect((i * 256) / room.heatColors.length, 0, 2, 1);
  });
  element("legend-low").textContent = `−${Math.round(-low)}`;
  element("legend-high").textContent = Math.round(high);
  element("legend-zero").style.left = `${(100 * -low) / (high - low)}%`;
};

const wire = (room) => {
  element("scrubber").addEventListener("input", (event) => {
    setPlaying(false);
    showFrame(Number(event.target.value));
  });
  element("play").addEventListener("click", () => setPlaying(!state.isPlaying));
  for (const button of all("[data-view]")) button.addEventListener("click", () => stage.look(button.dataset.view));
  for (const button of all("[data-layer]")) button.addEventListener("click", () => setLayer(button.dataset.layer));
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, select")) return;
    if (event.key === " " && !event.target.closest("button")) setPlaying(!state.isPlaying);
    else if (event.key === "ArrowRight") showFrame(state.frame + 1);
    else if (event.key === "ArrowLeft") showFrame(state.frame - 1);
    else if (event.key === "0") stage.look("reset");
    else if (LAYER_KEYS[event.key]) setLayer(LAYER_KEYS[event.key]);
    else return;
    event.preventDefault();
  });
  drawLegend(room);
};

const showFallback = (text) => {
  Object.assign(element("viewer-fallback"), { hidden: false, textContent: text });
  element("viewer").classList.add("without-webgl");
};
