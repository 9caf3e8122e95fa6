// The dressing room: a dressed person who plays while sliders change build, motion, fabric and size.
// The server answers a choice with coefficients and bones (src/dressing_room/mod.rs says in which order); the layer's
// components are added and the cloth is posed here, each frame anew.

Object.assign(state, { choice: null, answers: 0 });

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
    turnNormals(this);
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

class DressingRoom extends DressedStage {
  constructor(room, buffer) {
    const reader = new BlockReader(buffer);
    super(room, readDressedBody(room.body, reader), new Clothing(room.clothing, reader));
  }

  poseClothing(frame, bones) {
    const count = this.clothing.componentCount;
    const { base, coefficients } = this.sequence;
    this.clothing.dress(base, coefficients.subarray(frame * count, (frame + 1) * count), bones);
  }

  onLayer(name) {
    if (name === "clearance" || name === "penetration") ask();
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

const start = async () => {
  let outcome = "ready";
  try {
    const room = await (await fetch("/scene.json")).json();
    const buffer = await (await fetch("/scene.bin")).arrayBuffer();
    stage = new DressingRoom(room, buffer);
    document.querySelector('[data-layer="before"]').remove();
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
