// The page: one current frame, shown in the 3D view, the curves and the list alike.

const report = JSON.parse(document.getElementById("report-data").textContent);
const element = (id) => document.getElementById(id);
const all = (selector) => [...document.querySelectorAll(selector)];
const layers = { capture: true, body: true, heat: false, curves: false, landmarks: false, skeleton: false, follow: true };
const LAYER_KEYS = { c: "capture", b: "body", h: "heat", m: "curves", l: "landmarks", s: "skeleton", f: "follow" };
const state = { frame: 0, view: 0, isPlaying: false, speed: 1, row: null };
let stage = null;

const short = (value) => {
  if (value === null || !Number.isFinite(value)) return "–";
  const magnitude = Math.abs(value);
  if (magnitude && (magnitude < 1e-3 || magnitude >= 1e6)) return value.toExponential(2).replaceAll("-", "−");
  return value.toFixed(magnitude >= 100 || !magnitude ? 0 : magnitude >= 10 ? 1 : magnitude >= 1 ? 2 : 3).replace("-", "−");
};

// ---- the 3D view ----

class Stage {
  constructor() {
    this.canvas = element("canvas");
    this.body = readBody(report.body);
    this.renderer = new Renderer(this.canvas, this.body, { range: report.heatRange, colors: report.heatColors });
    this.frames = new Map();
    const captured = report.views.filter((view) => view.captureVertexCount);
    const first = this.frameData(0);
    const body = this.bodyHeights(first);
    this.floor = captured.length ? Math.min(...captured.map((view) => view.captureLow[1])) : body.low;
    const tops = captured.map((view) => view.captureLow[1] + view.captureSize[1]);
    this.height = Math.max(0.5, Math.max(body.high, ...tops) - this.floor);
    this.camera = new OrbitCamera(this.canvas, this.height * 0.63, () => this.request());
    this.home = this.root(first);
    this.camera.yaw = this.facing(first) + 0.45;
    this.canvas.addEventListener("webglcontextlost", () => showFallback("The browser has taken the graphics card away from this page; load the page again to have the 3D view back."));
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.readColors());
    this.readColors();
    this.resize();
  }

  frameData(number) {
    if (!this.frames.has(number)) this.frames.set(number, readFrame(report.views[number], number, this.body));
    return this.frames.get(number);
  }

  joint(frame, bone) {
    return moved(frame.bones, bone, this.body.joints[bone]);
  }

  root(frame) {
    return this.joint(frame, Math.max(0, this.body.parents.indexOf(null)));
  }

  /** Lowest and highest point of the posed body. */
  bodyHeights(frame) {
    let [low, high] = [Infinity, -Infinity];
    for (let vertex = 0; vertex < this.body.vertexCount; vertex++) {
      const place = this.body.positions.subarray(3 * vertex, 3 * vertex + 3);
      const y = skinned(this.body, frame.bones, vertex, place)[1];
      [low, high] = [Math.min(low, y), Math.max(high, y)];
    }
    return { low, high };
  }

  /** The yaw from which the camera sees the person's front. */
  facing(frame) {
    const root = Math.max(0, this.body.parents.indexOf(null)) * 12;
    return Math.atan2(frame.bones[root + 2], frame.bones[root + 10]);
  }

  readColors() {
    const style = getComputedStyle(document.documentElement);
    const color = (name) => style.getPropertyValue(name).trim().split(/\s+/).map((value) => Number(value) / 255);
    const number = (name) => style.getPropertyValue(name).trim().split(/\s+/).map(Number);
    this.colors = {
      background: color("--view-background"), body: color("--view-body"), capture: color("--view-capture"), ink: color("--view-ink"),
      curve: color("--view-curve"), landmark: color("--view-landmark"), skeleton: color("--view-skeleton"),
      captureOpacity: number("--view-capture-opacity"), shadow: number("--view-shadow")[0],
    };
    this.request();
  }

  resize() {
    this.pixelRatio = Math.min(2, devicePixelRatio || 1);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((side) => Math.max(1, Math.round(side * this.pixelRatio)));
    if (width !== this.canvas.width || height !== this.canvas.height) Object.assign(this.canvas, { width, height });
    this.draw();
  }

  request() {
    this.pending ??= requestAnimationFrame(() => this.draw());
  }

  draw() {
    if (this.pending) cancelAnimationFrame(this.pending);
    this.pending = null;
    const frame = this.frameData(state.view);
    if (this.shown !== state.view) this.renderer.setFrame(frame, state.view);
    this.shown = state.view;
    const root = layers.follow ? this.root(frame) : this.home;
    // A little above the middle: the buttons cover the top of the view.
    const target = [root[0], this.floor + this.height * 0.53, root[2]];
    const { eye, view, projection } = this.camera.matrices(target);
    const floor = eye[1] > this.floor + 0.02 ? [root[0], this.floor, root[2]] : null;
    const lines = [this.skeletonLines(frame), ...this.curveLines(frame)];
    const dots = layers.landmarks ? frame.landmarks.flatMap(([, place, confidence]) => [...place, confidence]) : [];
    this.renderer.draw({ view, projection, floor, layers, colors: this.colors, lines, dots, pixelRatio: this.pixelRatio });
  }

  curveLines(frame) {
    const chosen = this.body.curves.filter((curve) => layers.curves || curve.row === state.row);
    return chosen.map((curve) => {
      const places = curve.points.map((point, i) => skinned(this.body, frame.bones, curve.carriers[i], point));
      const ends = curve.isClosed ? [...places.slice(1), places[0]] : places.slice(1);
      const isChosen = curve.row === state.row;
      const alpha = state.row === null || isChosen ? 1 : 0.3;
      return { segments: ends.flatMap((end, i) => [...places[i], ...end]), color: [...this.colors.curve, alpha], width: (isChosen ? 2.6 : 1.6) * this.pixelRatio, isOnTop: isChosen };
    });
  }

  skeletonLines(frame) {
    const segments = !layers.skeleton ? [] : this.body.parents.flatMap((parent, bone) =>
      parent === null ? [] : [...this.joint(frame, parent), ...this.joint(frame, bone)]);
    return { segments, color: [...this.colors.skeleton, 1], width: 2 * this.pixelRatio, isOnTop: true };
  }

  look(name) {
    const facing = this.facing(this.frameData(state.view));
    const poses = { front: [facing, 0.05], side: [facing + Math.PI / 2, 0.05], back: [facing + Math.PI, 0.05], top: [facing, 1.55] };
    if (name === "reset") this.camera.fit();
    else this.camera.turn(...poses[name]);
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

// ---- one current frame everywhere ----

const nearestView = (frame) =>
  report.views.reduce((best, view, i) => (Math.abs(view.frame - frame) < Math.abs(report.views[best].frame - frame) ? i : best), 0);

const showFrame = (frame) => {
  state.frame = frame;
  if (report.views.length) state.view = nearestView(frame);
  update();
};

const showView = (view) => {
  state.view = (view + report.views.length) % report.views.length;
  state.frame = report.views[state.view].frame;
  update();
};

const update = () => {
  for (const button of all("#frame-list [aria-current]")) button.removeAttribute("aria-current");
  const current = document.querySelector(`#frame-list [data-frame="${state.frame}"]`);
  if (current) {
    current.setAttribute("aria-current", "true");
    const list = element("frame-list");
    const [top, bottom] = [current.offsetTop - list.offsetTop, current.offsetTop - list.offsetTop + current.offsetHeight];
    if (top < list.scrollTop) list.scrollTop = top;
    else if (bottom > list.scrollTop + list.clientHeight) list.scrollTop = bottom - list.clientHeight;
  }
  for (const figure of all(".plot")) updatePlot(figure);
  if (!stage) return;
  element("scrubber").value = state.view;
  const [shown, frame] = [report.views[state.view].frame, report.frames[state.frame]];
  element("frame-label").textContent = `${state.frame + 1} / ${report.frames.length}` + (shown === state.frame ? "" : ` (3D: ${shown + 1})`);
  element("frame-codes").replaceChildren(...frame.codes.map((code) => Object.assign(document.createElement("span"), { textContent: code })));
  element("frame-codes").className = `frame-codes ${frame.trust}`;
  element("scrubber").setAttribute("aria-valuetext", `frame ${state.frame + 1}, ${frame.name}, ${frame.codes.join(", ") || "no code"}`);
  stage.request();
};

const updatePlot = (figure) => {
  const plot = report.plots[figure.dataset.plot];
  const svg = figure.querySelector("svg");
  const width = svg.viewBox.baseVal.width;
  const [left, right] = [figure.dataset.left * width, figure.dataset.right * width];
  const x = left + ((right - left) * state.frame) / Math.max(1, report.frames.length - 1);
  figure.querySelector(".cursor").setAttribute("transform", `translate(${x} 0)`);
  const [reading, ...range] = plot.lines.map((values) => short(values[state.frame]));
  const spread = range.length ? ` (${range.join(" to ")})` : "";
  figure.querySelector(".plot-readout").textContent = `${reading}${spread} ${plot.unit}`.trim();
  const value = plot.lines[0][state.frame];
  const dot = figure.querySelector(".cursor-dot");
  dot.toggleAttribute("hidden", value === null);
  if (value !== null) {
    const [low, high, top, bottom] = ["low", "high", "top", "bottom"].map((key) => Number(figure.dataset[key]));
    dot.setAttribute("cx", x);
    dot.setAttribute("cy", top + ((bottom - top) * (high - value)) / (high - low));
  }
};

const setLayer = (name, isOn = !layers[name]) => {
  layers[name] = isOn;
  document.querySelector(`[data-layer="${name}"]`)?.setAttribute("aria-pressed", String(isOn));
  const legend = element("legend");
  if (legend) legend.hidden = !(layers.heat && layers.body);
  stage?.request();
};

const setPlaying = (isPlaying) => {
  state.isPlaying = isPlaying && report.views.length > 1;
  const button = element("play");
  button.classList.toggle("is-playing", state.isPlaying);
  button.setAttribute("aria-label", state.isPlaying ? "Pause" : "Play");
  if (!state.isPlaying) return;
  const frameSpan = report.views.at(-1).frame - report.views[0].frame;
  const millisecondsPerView = (1000 / report.framesPerSecond) * (frameSpan / (report.views.length - 1));
  let last = performance.now();
  let passed = 0;
  const tick = (now) => {
    if (!state.isPlaying) return;
    passed += Math.min(250, now - last) * state.speed;
    last = now;
    const steps = Math.floor(passed / millisecondsPerView);
    passed -= steps * millisecondsPerView;
    if (steps) showView(state.view + steps);
    requestAnimationFrame(tick);
  };
  requestAnimationFrame(tick);
};

// ---- wiring ----

const wirePlots = () => {
  for (const figure of all(".plot")) {
    const svg = figure.querySelector("svg");
    const jump = (event) => {
      const box = svg.getBoundingClientRect();
      const share = ((event.clientX - box.left) / box.width - figure.dataset.left) / (figure.dataset.right - figure.dataset.left);
      showFrame(Math.round(Math.min(1, Math.max(0, share)) * (report.frames.length - 1)));
    };
    svg.addEventListener("pointerdown", (event) => {
      svg.setPointerCapture(event.pointerId);
      jump(event);
    });
    svg.addEventListener("pointermove", (event) => event.buttons && jump(event));
  }
};

const wireRows = () => {
  const choose = (row) => {
    state.row = row;
    for (const other of all("[data-row]")) other.classList.toggle("chosen", Number(other.dataset.row) === row);
    stage?.request();
  };
  for (const row of all("[data-row]")) {
    const number = Number(row.dataset.row);
    const toggle = () => choose(state.row === number ? null : number);
    row.addEventListener("click", toggle);
    row.addEventListener("keydown", (event) => event.key === "Enter" && toggle());
  }
};

const wireViewer = () => {
  const scrubber = element("scrubber");
  scrubber.max = report.views.length - 1;
  scrubber.addEventListener("input", () => showView(Number(scrubber.value)));
  element("play").addEventListener("click", () => setPlaying(!state.isPlaying));
  element("speed").addEventListener("change", (event) => (state.speed = Number(event.target.value)));
  for (const button of all("[data-view]")) button.addEventListener("click", () => stage.look(button.dataset.view));
  for (const button of all("[data-layer]")) button.addEventListener("click", () => setLayer(button.dataset.layer));
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, select, textarea, pre")) return;
    const isButton = event.target.closest("button");
    if (event.key === " " && !isButton) setPlaying(!state.isPlaying);
    else if (event.key === "ArrowRight") showView(state.view + 1);
    else if (event.key === "ArrowLeft") showView(state.view - 1);
    else if (event.key === "Home") showView(0);
    else if (event.key === "End") showView(-1);
    else if (event.key === "0") stage.look("reset");
    else if (LAYER_KEYS[event.key]) setLayer(LAYER_KEYS[event.key]);
    else return;
    event.preventDefault();
  });
  const span = Math.max(1, report.views.length - 1);
  element("scrub-marks").innerHTML = report.views
    .map((view, i) => [report.frames[view.frame].trust, i])
    .filter(([trust]) => trust !== "clean")
    .map(([trust, i]) => `<i class="${trust}" style="left:${(100 * i) / span}%"></i>`)
    .join("");
  drawLegend();
};

const drawLegend = () => {
  const [low, high] = report.heatRange;
  const bar = element("legend-bar").getContext("2d");
  report.heatColors.forEach((color, i) => {
    bar.fillStyle = `rgb(${color.join(" ")})`;
    bar.fillRect((i * 256) / report.heatColors.length, 0, 2, 1);
  });
  element("legend-low").textContent = `−${Math.round(-low)}`;
  element("legend-high").textContent = Math.round(high);
  element("legend-zero").style.left = `${(100 * -low) / (high - low)}%`;
};

/** A link may name the frame and layers: #frame=12&heat=1&yaw=30 (degrees). */
const readLink = () => {
  const link = new URLSearchParams(location.hash.slice(1));
  for (const name of Object.keys(layers)) if (link.has(name)) setLayer(name, link.get(name) !== "0");
  if (stage && link.has("look")) stage.look(link.get("look"));
  if (stage && link.has("yaw")) stage.camera.turn((Number(link.get("yaw")) * Math.PI) / 180, ((Number(link.get("pitch")) || 5) * Math.PI) / 180);
  if (link.has("row")) document.querySelector(`[data-row="${Number(link.get("row"))}"]`)?.click();
  const frame = Number(link.get("frame") ?? 1) - 1;
  showFrame(Number.isInteger(frame) && frame >= 0 && frame < report.frames.length ? frame : 0);
};

const showFallback = (text) => {
  Object.assign(element("viewer-fallback"), { hidden: false, textContent: text });
  element("viewer").classList.add("without-webgl");
};

const start = () => {
  wirePlots();
  wireRows();
  for (const button of all("[data-frame]")) button.addEventListener("click", () => showFrame(Number(button.dataset.frame)));
  let outcome = "ready";
  if (report.views.length) {
    try {
      stage = new Stage();
      wireViewer();
    } catch (error) {
      stage = null;
      showFallback(`The 3D view cannot start here (${error.message}). It needs WebGL2; all curves and tables work without it.`);
      outcome = "without-3d";
    }
  }
  if (report.frames.length) readLink();
  stage?.draw();
  window.habitusReport = { showFrame, setLayer, setPlaying, snapshot: () => stage.snapshot(), state, layers };
  document.documentElement.dataset.state = outcome;
};

start();
