// The dressing room: a dressed person who plays while sliders change build, motion, fabric and size.
// The server answers a choice with coefficients and bones (src/dressing_room/mod.rs says in which order); the layer's
// components are added and the cloth is posed here, each frame anew.

const element = (id) => document.getElementById(id);
const all = (selector) => [...document.querySelectorAll(selector)];
const layers = { clothing: true, body: true, clearance: false, penetration: false, follow: true };
const LAYER_KEYS = { c: "clothing", b: "body", h: "clearance", p: "penetration", f: "follow" };
const state = { frame: 0, isPlaying: true, choice: null, answers: 0, framesDrawn: 0, secondsPlayed: 0 };

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

/** Adds components to the base and poses the sum; all arrays stay in place. */
class Clothing {
  constructor(head, reader) {
    Object.assign(this, head);
    this.faces = reader.faces(head.faceCount, head.vertexCount);
    this.weights = reader.take(Float32Array, head.vertexCount * head.influenceCount);
    this.bones = reader.take(Uint8Array, head.vertexCount * head.influenceCount);
    this.components = reader.take(Float32Array, head.componentCount * head.vertexCount * 3);
    this.rest = new Float32Array(head.vertexCount * 3);
    this.positions = new Float32Array(head.vertexCount * 3);
    this.normals = new Float32Array(head.vertexCount * 3);
  }

  dress(base, coefficients, boneRows) {
    const { rest, positions, components, weights, bones, influenceCount } = this;
    const length = rest.length;
    rest.set(base);
    for (let k = 0; k < this.componentCount; k++) {
      const coefficient = coefficients[k];
      if (Math.abs(coefficient) < 1e-7) continue;
      const first = k * length;
      for (let i = 0; i < length; i++) rest[i] += coefficient * components[first + i];
    }
    const rows = new Float32Array(12);
    for (let vertex = 0, at = 0; vertex < this.vertexCount; vertex++) {
      rows.fill(0);
      for (let k = 0; k < influenceCount; k++, at++) {
        const weight = weights[at];
        if (weight === 0) continue;
        const bone = bones[at] * 12;
        for (let r = 0; r < 12; r++) rows[r] += weight * boneRows[bone + r];
      }
      const i = vertex * 3;
      const [x, y, z] = [rest[i], rest[i + 1], rest[i + 2]];
      positions[i] = rows[0] * x + rows[1] * y + rows[2] * z + rows[3];
      positions[i + 1] = rows[4] * x + rows[5] * y + rows[6] * z + rows[7];
      positions[i + 2] = rows[8] * x + rows[9] * y + rows[10] * z + rows[11];
    }
    this.turnNormals();
  }

  /** Area-weighted; the shader brings them to unit length. */
  turnNormals() {
    const { positions, normals, faces } = this;
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
  }
}

const readSequence = (buffer, room) => {
  const reader = new BlockReader(buffer);
  const [frameCount, hasClearance] = reader.take(Uint32Array, 2);
  const rest = reader.take(Float32Array, room.body.vertexCount * 3);
  const base = reader.take(Float32Array, room.clothing.vertexCount * 3);
  const bones = reader.take(Float32Array, frameCount * room.body.boneCount * 12);
  const coefficients = reader.take(Float32Array, frameCount * room.clothing.componentCount);
  const clearance = hasClearance ? reader.take(Int8Array, frameCount * room.clothing.vertexCount) : null;
  return { frameCount, rest, base, bones, coefficients, clearance };
};

class DressingRoom {
  constructor(room, buffer) {
    this.room = room;
    const reader = new BlockReader(buffer);
    const { vertexCount, faceCount, boneCount } = room.body;
    const faces = reader.faces(faceCount, vertexCount);
    const weights = reader.take(Uint8Array, vertexCount * 4);
    const bones = reader.take(Uint8Array, vertexCount * 4);
    const positions = new Float32Array(vertexCount * 3);
    this.body = { vertexCount, faces, weights, bones, positions, joints: { length: boneCount }, normals: new Int8Array(vertexCount * 4) };
    this.clothing = new Clothing(room.clothing, reader);
    this.canvas = element("canvas");
    this.renderer = new DressedRenderer(this.canvas, this.body, this.clothing, { range: room.heatRange, colors: room.heatColors });
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

  clearanceOf(frame) {
    const size = this.clothing.vertexCount;
    return this.sequence.clearance?.subarray(frame * size, (frame + 1) * size);
  }

  showPenetration() {
    const note = element("penetration-note");
    const { clearance } = this.sequence;
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
      const count = this.clothing.componentCount;
      this.clothing.dress(this.sequence.base, this.sequence.coefficients.subarray(frame * count, (frame + 1) * count), bones);
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
}

// ---- controls ----

const signed = (value) => value.toFixed(2).replace("-", "−");

const slider = (name, label, { low, high, step, value }) => {
  const line = document.createElement("label");
  const output = Object.assign(document.createElement("output"), { textContent: signed(value) });
  const input = Object.assign(document.createElement("input"), { type: "range", min: low, max: high, step, name });
  input.value = value;
  input.dataset.home = value;
  input.addEventListener("input", () => (output.textContent = signed(Number(input.value))));
  line.append(label, output, input);
  return line;
};

const choice = (name, label, options) => {
  const line = document.createElement("label");
  const select = Object.assign(document.createElement("select"), { name });
  select.append(...options.map((text, i) => Object.assign(document.createElement("option"), { value: i, textContent: text })));
  line.append(label, select);
  return line;
};

const group = (title, lines) => {
  if (!lines.length) return [];
  const set = document.createElement("fieldset");
  set.append(Object.assign(document.createElement("legend"), { textContent: title }), ...lines);
  return [set];
};

const deviations = { low: -3, high: 3, step: 0.05, value: 0 };

const buildControls = (room) => {
  const form = element("controls");
  const identity = Array.from({ length: room.identityCount }, (_, k) => slider(`identity_${k}`, `Build ${k + 1}, σ`, deviations));
  const fabric = room.fabrics.length ? [choice("fabric", "Fabric", room.fabrics.map(({ name }) => name))] : [];
  const components = Array.from({ length: room.fabricComponentCount }, (_, k) =>
    slider(`fabric_${k}`, `Component ${k + 1}`, { ...deviations, value: room.fabrics[0]?.components[k] ?? 0 }));
  const sizes = room.sizes.map((size) => slider(`size_${size.name}`, size.label, { ...size, step: "any" }));
  const reset = Object.assign(document.createElement("button"), { type: "button", id: "reset", textContent: "As it was" });
  form.append(
    ...group("Motion", [choice("motion", "Motion", room.motions)]), ...group("Size", sizes),
    ...group("Fabric", [...fabric, ...components]), ...group("Build", identity), reset);
  form.addEventListener("input", (event) => {
    if (event.target.name === "fabric") chooseFabric(room, Number(event.target.value));
    ask();
  });
  form.addEventListener("submit", (event) => event.preventDefault());
  reset.addEventListener("click", () => {
    for (const input of form.querySelectorAll("input")) setSlider(input, Number(input.dataset.home));
    for (const select of form.querySelectorAll("select")) select.value = 0;
    ask();
  });
};

const setSlider = (input, value) => {
  input.value = value;
  input.parentElement.querySelector("output").textContent = signed(Number(value));
};

const chooseFabric = (room, index) =>
  room.fabrics[index].components.forEach((value, k) => setSlider(document.querySelector(`[name="fabric_${k}"]`), value));

/** What the controls say, as the server reads it. */
const query = () => {
  const form = new FormData(element("controls"));
  const named = (prefix) => [...form.entries()].filter(([name]) => name.startsWith(prefix)).map(([, value]) => value).join(",");
  const values = { motion: form.get("motion") ?? 0, identity: named("identity_"), fabric: named("fabric_"), sizes: named("size_") };
  if (layers.clearance || layers.penetration) values.clearance = "1";
  return Object.entries(values).map(([name, value]) => `${name}=${value}`).join(";");
};

let stage = null;
let waiting = null;
let isAsking = false;

/** One question at a time; the newest one is asked when the last is answered. */
const ask = () => {
  waiting = query();
  if (!isAsking) answer();
};

const answer = async () => {
  isAsking = true;
  while (waiting !== null && waiting !== state.choice) {
    const wanted = waiting;
    const begin = performance.now();
    try {
      const response = await fetch(`/sequence/${wanted}`);
      if (!response.ok) throw new Error(await response.text());
      stage.setSequence(readSequence(await response.arrayBuffer(), stage.room));
      element("answer").textContent = `answered in ${Math.round(performance.now() - begin)} ms`;
      state.choice = wanted;
      state.answers++;
    } catch (error) {
      element("answer").textContent = String(error.message);
      state.choice = wanted;
    }
    if (waiting === wanted) waiting = null;
  }
  waiting = null;
  isAsking = false;
};

const setLayer = (name, isOn = !layers[name]) => {
  layers[name] = isOn;
  document.querySelector(`[data-layer="${name}"]`)?.setAttribute("aria-pressed", String(isOn));
  element("legend").hidden = !layers.clearance;
  if (name === "clearance" || name === "penetration") ask();
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
      element("rate").textContent = `${Math.round((1000 * drawn) / (now - since))} frames/s`;
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

const start = async () => {
  let outcome = "ready";
  try {
    const room = await (await fetch("/scene.json")).json();
    const buffer = await (await fetch("/scene.bin")).arrayBuffer();
    stage = new DressingRoom(room, buffer);
    buildControls(room);
    wire(room);
    waiting = query();
    await answer();
    setPlaying(true);
    play();
  } catch (error) {
    showFallback(`The dressing room cannot start here (${error.message}). It needs WebGL2 and the habitus that served it.`);
    outcome = "failed";
  }
  window.dressingRoom = { state, layers, setLayer, showFrame, setPlaying, ask, isIdle: () => !isAsking, stage };
  document.documentElement.dataset.state = outcome;
};

start();
