// The camera that turns about the person, moved by mouse, touch and buttons.

const OPENING = (32 * Math.PI) / 180;

class OrbitCamera {
  constructor(canvas, radius, onChange) {
    Object.assign(this, { canvas, radius, onChange, pan: [0, 0, 0], yaw: 0.5, pitch: 0.12, zoom: 1 });
    this.pointers = new Map();
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, event);
    });
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const name of ["pointerup", "pointercancel"])
      canvas.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("dblclick", () => this.fit());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoomBy(Math.exp(-0.0015 * event.deltaY * (event.deltaMode ? 16 : 1)));
    }, { passive: false });
  }

  drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
    const others = [...this.pointers.values()].filter((other) => other.pointerId !== event.pointerId);
    if (others.length) {
      const reach = (e) => Math.hypot(e.clientX - others[0].clientX, e.clientY - others[0].clientY) || 1;
      this.zoomBy(reach(event) / reach(before));
      this.move(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons & 6) {
      this.move(dx, dy);
    } else {
      this.yaw -= dx * 0.008;
      this.pitch = Math.min(1.55, Math.max(-1.2, this.pitch + dy * 0.008));
    }
    this.pointers.set(event.pointerId, event);
    this.onChange();
  }

  zoomBy(factor) {
    this.zoom = Math.min(12, Math.max(0.25, this.zoom * factor));
    this.onChange();
  }

  move(dx, dy) {
    const metres = (2 * this.distance() * Math.tan(OPENING / 2)) / this.canvas.clientHeight;
    const right = [Math.cos(this.yaw), 0, -Math.sin(this.yaw)];
    const up = [-Math.sin(this.pitch) * Math.sin(this.yaw), Math.cos(this.pitch), -Math.sin(this.pitch) * Math.cos(this.yaw)];
    this.pan = add(this.pan, add(scale(right, -dx * metres), scale(up, dy * metres)));
  }

  fit() {
    Object.assign(this, { pan: [0, 0, 0], zoom: 1 });
    this.onChange();
  }

  turn(yaw, pitch) {
    Object.assign(this, { yaw, pitch, pan: [0, 0, 0] });
    this.onChange();
  }

  distance() {
    const aspect = this.canvas.clientWidth / Math.max(1, this.canvas.clientHeight);
    return (this.radius / Math.sin(OPENING / 2) / this.zoom) * Math.max(1, 0.8 / aspect);
  }

  /** View and projection for a target that may move with the person. */
  matrices(target) {
    const center = add(target, this.pan);
    const distance = this.distance();
    const toward = [Math.cos(this.pitch) * Math.sin(this.yaw), Math.sin(this.pitch), Math.cos(this.pitch) * Math.cos(this.yaw)];
    const eye = add(center, scale(toward, distance));
    const aspect = this.canvas.width / Math.max(1, this.canvas.height);
    return { eye, view: lookAt(eye, center, [0, 1, 0]), projection: perspective(OPENING, aspect, distance * 0.05, distance + 20) };
  }
}
