// The review page: one current scan, its registration over it, and what the person says about it.

const element = (id) => document.getElementById(id);
const all = (selector) => [...document.querySelectorAll(selector)];
const state = { scans: [], order: [], current: -1, sort: "score", filter: "all", search: "", reach: 10, undo: [] };
const layers = { scan: true, registration: true, error: true };
const LAYER_KEYS = { s: "scan", m: "registration", e: "error" };
const VERDICT_WORDS = { accept: "accepted", reject: "rejected", undecided: "undecided" };
/** Hundredths of a millimetre. */
const ERROR_UNIT = 100;
/** Metres up to which scan and registration count as one surface for the eye. */
const COINCIDENT = 0.0015;
let stage = null;

// ---- the 3D view ----

const IDENTITY_BONE = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]);

/** A registration and its scan as src/review/block.rs lays them out. */
const readRegistration = (buffer) => {
  const headLength = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, headLength)));
  const reader = new BlockReader(buffer);
  reader.offset = Math.ceil((4 + headLength) / 4) * 4;
  const count = head.vertexCount;
  const body = { vertexCount: count, joints: [[0, 0, 0]], bones: new Uint8Array(4 * count), weights: new Uint8Array(4 * count) };
  for (let vertex = 0; vertex < count; vertex++) body.weights[4 * vertex] = 255;
  body.positions = reader.take(Float32Array, 3 * count);
  const clearance = reader.take(Int16Array, count);
  body.faces = reader.faces(head.faceCount, count);
  body.normals = vertexNormals(body.positions, body.faces);
  const quantized = reader.take(Uint16Array, 3 * head.scanVertexCount);
  const captureHeat = reader.take(Int16Array, head.scanVertexCount);
  const faces = reader.faces(head.scanFaceCount, head.scanVertexCount);
  const positions = new Float32Array(quantized.length);
  for (let i = 0; i < quantized.length; i++) positions[i] = head.scanLow[i % 3] + (quantized[i] / 65535) * head.scanSize[i % 3];
  return { ...head, body, bones: IDENTITY_BONE, clearance, captureHeat, positions, faces, normals: vertexNormals(positions, faces) };
};

class ReviewStage {
  constructor(heatColors) {
    this.canvas = element("canvas");
    const nothing = { vertexCount: 0, joints: [[0, 0, 0]], positions: new Float32Array(), normals: new Int8Array(), faces: new Uint16Array(), weights: new Uint8Array(), bones: new Uint8Array() };
    this.renderer = new Renderer(this.canvas, nothing, { range: [-1000, 1000], colors: heatColors });
    this.camera = new OrbitCamera(this.canvas, 1.15, () => this.request());
    this.target = [0, 0.9, 0];
    this.shown = null;
    this.canvas.addEventListener("webglcontextlost", () => showFallback("The browser has taken the graphics card away from this page; load the page again to have the 3D view back."));
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.readColors());
    this.readColors();
    this.resize();
  }

  readColors() {
    const style = getComputedStyle(document.documentElement);
    const color = (name) => style.getPropertyValue(name).trim().split(/\s+/).map((value) => Number(value) / 255);
    const number = (name) => style.getPropertyValue(name).trim().split(/\s+/).map(Number);
    this.colors = {
      background: color("--view-background"), body: color("--view-body"), capture: color("--view-capture"), ink: color("--view-ink"),
      landmark: color("--view-landmark"), captureOpacity: number("--view-capture-opacity"), shadow: number("--view-shadow")[0],
    };
    this.request();
  }

  resize() {
    this.pixelRatio = Math.min(2, devicePixelRatio || 1);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((side) => Math.max(1, Math.round(side * this.pixelRatio)));
    if (width !== this.canvas.width || height !== this.canvas.height) Object.assign(this.canvas, { width, height });
    this.draw();
  }

  /** Takes over a registration; the camera stays where it is, so that scans can be compared. */
  show(registration) {
    this.shown = registration;
    this.renderer.discardCaptures();
    this.renderer.setBody(registration.body);
    this.renderer.setFrame(registration, registration.name);
    const positions = registration.body.positions;
    const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    for (let i = 0; i < positions.length; i++) {
      low[i % 3] = Math.min(low[i % 3], positions[i]);
      high[i % 3] = Math.max(high[i % 3], positions[i]);
    }
    this.floor = low[1];
    this.home = scale(add(low, high), 0.5);
    this.camera.radius = 0.58 * Math.hypot(...subtract(high, low));
    this.target = this.home;
    this.request();
  }

  request() {
    this.pending ??= requestAnimationFrame(() => this.draw());
  }

  draw() {
    if (this.pending) cancelAnimationFrame(this.pending);
    this.pending = null;
    const { shown, pixelRatio, colors } = this;
    const { eye, view, projection } = this.camera.matrices(this.target);
    const isEmpty = !shown;
    const floor = !isEmpty && eye[1] > this.floor + 0.02 ? [this.home[0], this.floor, this.home[2]] : null;
    const showsBoth = layers.scan && layers.registration;
    this.renderer.heatRange = [-state.reach * ERROR_UNIT, state.reach * ERROR_UNIT];
    const drawn = { body: !isEmpty && layers.registration, capture: !isEmpty && layers.scan, heat: layers.error, captureHeat: layers.error && !showsBoth };
    const dots = !isEmpty && this.isAtWorst ? [...this.worstPlace(), 1] : [];
    // Depth grows as 2 near / distance² at the person, and near is a twentieth of the distance.
    const setBack = (0.1 * COINCIDENT) / this.camera.distance();
    this.renderer.draw({ view, projection, floor, layers: drawn, colors, lines: [], dots, pixelRatio, setBack, veil: 1 });
  }

  worstPlace() {
    const place = 3 * this.shown.worstVertex;
    return [...this.shown.body.positions.subarray(place, place + 3)];
  }

  /** Registrations stand upright and face +z, as their template does. */
  look(name) {
    const poses = { front: [0, 0.05], side: [Math.PI / 2, 0.05], back: [Math.PI, 0.05] };
    if (!this.shown) return;
    const { yaw, pitch } = this.camera;
    if (name === "worst" && !this.isAtWorst) this.before = [yaw, pitch];
    const wasAtWorst = this.isAtWorst;
    this.isAtWorst = name === "worst";
    if (name === "worst") {
      this.target = this.worstPlace();
      const [x, y, z] = this.worstNormal();
      this.camera.turn(Math.atan2(x, z), Math.max(-0.6, Math.min(0.8, Math.asin(y))));
      this.camera.zoom = 4;
    } else {
      this.target = this.home;
      if (name === "reset") {
        if (wasAtWorst) this.camera.turn(...this.before);
        this.camera.fit();
      } else {
        this.camera.turn(...poses[name]);
        this.camera.zoom = 1;
      }
    }
    this.request();
  }

  worstNormal() {
    const place = 4 * this.shown.worstVertex;
    return normalize([...this.shown.body.normals.subarray(place, place + 3)]);
  }

  /** The pixels as they stand, for checks. */
  snapshot() {
    this.draw();
    const { gl, canvas } = this.renderer;
    const pixels = new Uint8Array(canvas.width * canvas.height * 4);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return pixels;
  }
}

// ---- talking to the program ----

const blocks = new Map();
const BLOCKS_KEPT = 6;

/** The block of a scan, read once and kept for a while. */
const blockOf = (name) => {
  if (!blocks.has(name)) {
    const arriving = fetch(`api/registration/${encodeURIComponent(name)}`).then(async (response) => {
      if (!response.ok) throw new Error(await response.text());
      return response.arrayBuffer();
    });
    arriving.catch(() => blocks.delete(name));
    blocks.set(name, arriving);
    if (blocks.size > BLOCKS_KEPT) blocks.delete(blocks.keys().next().value);
  }
  return blocks.get(name);
};

const post = async (path, value) => {
  const response = await fetch(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(value) });
  if (!response.ok) throw new Error(await response.text());
  return response.json();
};

let toastTimer = 0;
const tell = (text, isTrouble = false) => {
  const toast = element("toast");
  Object.assign(toast, { textContent: text, hidden: false, className: isTrouble ? "toast trouble" : "toast" });
  clearTimeout(toastTimer);
  if (!isTrouble) toastTimer = setTimeout(() => (toast.hidden = true), 2500);
};

// ---- lists and numbers ----

const verdictOf = (scan) => scan.verdict ?? "undecided";
const criterion = () => state.criteria.find((one) => one.key === state.sort);
const shown = (value, decimals) => (value === null || value === undefined ? "–" : value.toFixed(decimals).replace("-", "−"));
const worstOf = (scan) => state.criteria.slice(1).reduce((worst, one) => ((scan.shares[one.key] ?? 0) > (scan.shares[worst.key] ?? 0) ? one : worst));

/** Numbers of the scans that pass the filter, worst first by the criterion; by name it is A to Z. */
const arrange = () => {
  const search = state.search.toLowerCase();
  const passes = (scan) => (state.filter === "all" || verdictOf(scan) === state.filter) &&
    (!search || scan.name.toLowerCase().includes(search) || scan.note.toLowerCase().includes(search));
  const value = (scan) => scan.values[state.sort] ?? -Infinity;
  const collator = new Intl.Collator("en", { numeric: true });
  const byName = (a, b) => collator.compare(state.scans[a].name, state.scans[b].name);
  state.order = state.scans.map((_, i) => i).filter((i) => passes(state.scans[i]));
  state.order.sort(state.sort === "name" ? byName : (a, b) => value(state.scans[b]) - value(state.scans[a]) || byName(a, b));
};

const span = (className, text) => Object.assign(document.createElement("span"), { className, textContent: text });

const rowOf = (number) => {
  const scan = state.scans[number];
  const button = Object.assign(document.createElement("button"), { type: "button", className: `scan ${verdictOf(scan)}` });
  button.dataset.scan = number;
  const key = state.sort === "name" ? "score" : state.sort;
  const one = state.criteria.find((other) => other.key === key);
  const isOver = (scan.shares[key] ?? 0) > 1;
  const worst = worstOf(scan);
  const why = scan.note || `${worst.label} ${shown(scan.values[worst.key], worst.decimals)} ${worst.unit}`;
  button.append(span("dot", ""), span("name", scan.name), span(isOver ? "value over" : "value", shown(scan.values[key], one.decimals)), span("why", why));
  button.setAttribute("aria-label", `${scan.name}, ${VERDICT_WORDS[verdictOf(scan)]}, score ${shown(scan.values.score, 2)}`);
  button.addEventListener("click", () => show(number));
  const item = document.createElement("li");
  item.append(button);
  return item;
};

const updateList = () => {
  arrange();
  element("scan-list").replaceChildren(...state.order.map(rowOf));
  element("empty").hidden = state.order.length > 0;
  markCurrent();
};

const updateRow = (number) => {
  element("scan-list").querySelector(`[data-scan="${number}"]`)?.parentElement.replaceWith(rowOf(number));
  markCurrent();
};

const markCurrent = () => {
  for (const row of all("#scan-list [aria-current]")) row.removeAttribute("aria-current");
  const row = element("scan-list").querySelector(`[data-scan="${state.current}"]`);
  row?.setAttribute("aria-current", "true");
  row?.scrollIntoView({ block: "nearest" });
};

const updateProgress = () => {
  const count = (verdict) => state.scans.filter((scan) => verdictOf(scan) === verdict).length;
  const [total, accepted, rejected] = [state.scans.length, count("accept"), count("reject")];
  element("progress-accepted").style.width = `${(100 * accepted) / Math.max(1, total)}%`;
  element("progress-rejected").style.width = `${(100 * rejected) / Math.max(1, total)}%`;
  const track = element("progress-track");
  track.setAttribute("aria-valuemax", total);
  track.setAttribute("aria-valuenow", accepted + rejected);
  element("progress-text").textContent = `${accepted} accepted, ${rejected} rejected, ${total - accepted - rejected} to decide`;
};

const updateJudge = () => {
  const scan = state.scans[state.current];
  for (const id of ["accept", "reject", "note"]) element(id).disabled = !scan;
  if (!scan) return;
  element("scan-name").textContent = scan.name;
  const tag = element("scan-verdict");
  const earlier = scan.earlierVerdict && !scan.verdict ? `; ${VERDICT_WORDS[scan.earlierVerdict]} before it was registered anew` : "";
  Object.assign(tag, { textContent: VERDICT_WORDS[verdictOf(scan)] + earlier, className: `tag ${verdictOf(scan)}` });
  const place = state.order.indexOf(state.current);
  element("scan-place").textContent = place < 0 ? "" : `${place + 1} of ${state.order.length}`;
  for (const verdict of ["accept", "reject"]) element(verdict).setAttribute("aria-pressed", String(scan.verdict === verdict));
  if (document.activeElement !== element("note")) element("note").value = scan.note;
  element("parts").replaceChildren(...state.criteria.filter((one) => scan.values[one.key] !== null && one.key !== "name").map((one) => {
    const share = scan.shares[one.key] ?? 0;
    const group = Object.assign(document.createElement("div"), { className: share > 1 ? "over" : "", title: one.title });
    const bar = span("share", "");
    const fill = document.createElement("i");
    fill.style.width = `${Math.min(100, 100 * share)}%`;
    bar.append(fill);
    const term = Object.assign(document.createElement("dt"), { textContent: one.label });
    const value = Object.assign(document.createElement("dd"), { textContent: `${shown(scan.values[one.key], one.decimals)} ${one.unit}`.trim() });
    value.append(bar);
    group.append(term, value);
    return group;
  }));
};

// ---- moving and judging ----

const show = async (number) => {
  if (number === undefined || number < 0) return;
  if (document.activeElement === element("note")) element("note").blur();
  state.current = number;
  updateJudge();
  markCurrent();
  const { name } = state.scans[number];
  document.documentElement.dataset.shown = "";
  if (!stage) return void (document.documentElement.dataset.shown = name);
  try {
    const registration = readRegistration(await blockOf(name));
    // Another scan may have been asked for in the meantime.
    if (state.current !== number) return;
    stage.show(registration);
    if (stage.isAtWorst) stage.look("worst");
    element("viewer-fallback").hidden = true;
    document.documentElement.dataset.shown = name;
    const following = state.order[state.order.indexOf(number) + 1];
    if (following !== undefined) blockOf(state.scans[following].name).catch(() => {});
  } catch (error) {
    if (state.current === number) showFallback(`${name} cannot be shown: ${error.message}`);
  }
};

const step = (by) => {
  const place = state.order.indexOf(state.current);
  show(state.order[place < 0 ? 0 : Math.min(state.order.length - 1, Math.max(0, place + by))]);
};

/** The next scan in the list without a verdict, from the current place on and then from the top. */
const nextUndecided = (order = state.order, place = order.indexOf(state.current)) => {
  const turned = [...order.slice(place + 1), ...order.slice(0, place + 1)];
  return turned.find((number) => !state.scans[number].verdict);
};

const goToUndecided = () => {
  const next = nextUndecided();
  if (next === undefined) tell("Every scan of this list is decided.");
  else show(next);
};

/** Decisions are sent one after the other, so that the file holds the last word. */
let sending = Promise.resolve();
const send = (number, change) => {
  const scan = state.scans[number];
  const before = { verdict: scan.verdict, note: scan.note };
  Object.assign(scan, change);
  const decision = { scan: scan.name, verdict: scan.verdict, note: scan.note };
  updateProgress();
  sending = sending.then(() => post("api/decision", decision)).catch((error) => {
    Object.assign(scan, before);
    updateProgress();
    updateRow(number);
    updateJudge();
    tell(`Not kept: ${error.message}`, true);
  });
  return before;
};

const judge = (verdict) => {
  const number = state.current;
  if (number < 0) return;
  const isSame = state.scans[number].verdict === verdict;
  const order = state.order;
  const place = order.indexOf(number);
  state.undo.push({ number, before: send(number, { verdict: isSame ? null : verdict }) });
  if (state.filter === "all") updateRow(number);
  else updateList();
  const next = isSame ? undefined : nextUndecided(order, place);
  tell(`${state.scans[number].name} ${VERDICT_WORDS[verdictOf(state.scans[number])]}` + (next === undefined && !isSame ? ". Every scan of this list is decided." : ""));
  if (next === undefined) updateJudge();
  else show(next);
};

const takeBack = () => {
  const last = state.undo.pop();
  if (!last) return tell("There is nothing to take back.");
  send(last.number, last.before);
  updateList();
  tell(`${state.scans[last.number].name} ${VERDICT_WORDS[verdictOf(state.scans[last.number])]} again`);
  show(last.number);
};

const keepNote = () => {
  const scan = state.scans[state.current];
  const note = element("note").value.trim();
  if (!scan || note === scan.note) return;
  state.undo.push({ number: state.current, before: send(state.current, { note }) });
  updateRow(state.current);
};

const setLayer = (name, isOn = !layers[name]) => {
  layers[name] = isOn;
  document.querySelector(`[data-layer="${name}"]`).setAttribute("aria-pressed", String(isOn));
  updateLegend();
  stage?.request();
};

const updateLegend = () => {
  element("legend").hidden = !layers.error || !(layers.registration || layers.scan);
  const isOfScan = !layers.registration;
  element("legend-what").textContent = isOfScan ? "Scan to registration" : "Registration to scan";
  element("legend-below").textContent = isOfScan ? "scan inside" : "inside the scan";
  element("legend-above").textContent = isOfScan ? "outside" : "outside";
  element("legend-low").textContent = `−${state.reach}`;
  element("legend-high").textContent = state.reach;
};

const setReach = (factor) => {
  state.reach = Math.min(160, Math.max(1.25, state.reach * factor));
  updateLegend();
  stage?.request();
};

const setFilter = (filter) => {
  state.filter = filter;
  for (const button of all("[data-filter]")) button.setAttribute("aria-pressed", String(button.dataset.filter === filter));
  updateList();
  updateJudge();
};

const finish = async () => {
  await sending;
  try {
    await post("api/finish", {});
    document.documentElement.dataset.state = "finished";
    element("finish").disabled = true;
    tell("Finished: the decisions are in the run folder, and this page can be closed.");
  } catch (error) {
    tell(`The program does not answer: ${error.message}`, true);
  }
};

// ---- wiring ----

const KEYS = {
  a: () => judge("accept"), r: () => judge("reject"), z: takeBack, u: goToUndecided, " ": goToUndecided,
  j: () => step(1), ArrowDown: () => step(1), ArrowRight: () => step(1), k: () => step(-1), ArrowUp: () => step(-1), ArrowLeft: () => step(-1),
  Home: () => show(state.order[0]), End: () => show(state.order.at(-1)),
  n: () => element("note").focus(), "/": () => element("search").focus(),
  w: () => stage?.look("worst"), 0: () => stage?.look("reset"), "[": () => setReach(0.5), "]": () => setReach(2),
};

const wire = () => {
  element("accept").addEventListener("click", () => judge("accept"));
  element("reject").addEventListener("click", () => judge("reject"));
  element("previous").addEventListener("click", () => step(-1));
  element("next").addEventListener("click", () => step(1));
  element("next-undecided").addEventListener("click", goToUndecided);
  element("finish").addEventListener("click", finish);
  element("note").addEventListener("blur", keepNote);
  element("search").addEventListener("input", (event) => {
    state.search = event.target.value;
    updateList();
    updateJudge();
  });
  element("sort").append(...state.criteria.map((one) => Object.assign(document.createElement("option"), { value: one.key, textContent: one.choice })));
  element("sort").addEventListener("change", (event) => {
    state.sort = event.target.value;
    updateList();
    updateJudge();
  });
  for (const button of all("[data-filter]")) button.addEventListener("click", () => setFilter(button.dataset.filter));
  for (const button of all("[data-layer]")) button.addEventListener("click", () => setLayer(button.dataset.layer));
  for (const button of all("[data-view]")) button.addEventListener("click", () => stage?.look(button.dataset.view));
  for (const button of all("[data-reach]")) button.addEventListener("click", () => setReach(Number(button.dataset.reach)));
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.closest("input, select")) {
      if (event.key === "Enter" || event.key === "Escape") event.target.blur();
      return;
    }
    if (event.key === " " && event.target.closest("button")) return;
    const act = KEYS[event.key] ?? (LAYER_KEYS[event.key] && (() => setLayer(LAYER_KEYS[event.key])));
    if (!act) return;
    event.preventDefault();
    act();
  });
};

const drawLegend = (colors) => {
  const bar = element("legend-bar").getContext("2d");
  colors.forEach((color, i) => {
    bar.fillStyle = `rgb(${color.join(" ")})`;
    bar.fillRect((i * 256) / colors.length, 0, 2, 1);
  });
  element("legend-zero").style.left = "50%";
  updateLegend();
};

const showFallback = (text) => Object.assign(element("viewer-fallback"), { hidden: false, textContent: text });

const start = async () => {
  const data = await (await fetch("api/scans")).json();
  state.criteria = data.criteria;
  state.scans = data.scans;
  let outcome = "ready";
  try {
    stage = new ReviewStage(data.heatColors);
  } catch (error) {
    showFallback(`The 3D view cannot start here (${error.message}). It needs WebGL2; lists and decisions work without it.`);
    outcome = "without-3d";
  }
  wire();
  drawLegend(data.heatColors);
  updateList();
  updateProgress();
  updateJudge();
  window.habitusReview = { state, layers, snapshot: () => stage.snapshot(), camera: () => stage.camera, settled: () => sending };
  await show(nextUndecided() ?? state.order[0]);
  document.documentElement.dataset.state = outcome;
};

start().catch((error) => {
  document.documentElement.dataset.state = "failed";
  tell(`This page cannot start: ${error.message}`, true);
});
