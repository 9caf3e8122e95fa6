// A dressed person in a report: the clothing of each frame is in the page (src/dressed_report/mod.rs says in which order).

/** Where the clothing of a frame is, before and after it was pushed out of the body. */
class FrameShapes {
  constructor(head, reader) {
    this.low = reader.take(Float32Array, 3);
    this.size = reader.take(Float32Array, 3);
    this.places = reader.take(Uint16Array, head.vertexCount * 3);
  }
  into(positions) {
    for (let i = 0; i < positions.length; i += 3)
      for (let k = 0; k < 3; k++) positions[i + k] = this.low[k] + (this.places[i + k] / 65535) * this.size[k];
  }
}

const readClip = (room, reader) => {
  const { vertexCount, frameCount, hasClearance, hasBefore } = room.clothing;
  const rest = reader.take(Float32Array, room.body.vertexCount * 3);
  const bones = reader.take(Float32Array, frameCount * room.body.boneCount * 12);
  const variant = () => ({
    shapes: Array.from({ length: frameCount }, () => new FrameShapes(room.clothing, reader)),
    clearance: hasClearance ? reader.take(Int8Array, frameCount * vertexCount) : null,
  });
  const shown = variant();
  return { frameCount, rest, bones, shown, before: hasBefore ? variant() : null };
};

class DressedReport extends DressedStage {
  constructor(room, reader) {
    const body = readDressedBody(room.body, reader);
    const { vertexCount, faceCount } = room.clothing;
    const faces = reader.faces(faceCount, vertexCount);
    const [positions, normals] = [new Float32Array(vertexCount * 3), new Float32Array(vertexCount * 3)];
    super(room, body, { vertexCount, faces, positions, normals });
    this.setSequence(readClip(room, reader));
  }

  variant() {
    return (layers.before && this.sequence.before) || this.sequence.shown;
  }

  clearances() {
    return this.variant().clearance;
  }

  poseClothing(frame) {
    this.variant().shapes[frame].into(this.clothing.positions);
    turnNormals(this.clothing);
  }

  onLayer(name) {
    if (name === "before") this.shown = null;
  }
}

const startReport = () => {
  let outcome = "ready";
  try {
    const room = JSON.parse(element("report-data").textContent);
    stage = new DressedReport(room, new BlockReader(readBlock("block-dressed")));
    if (!room.clothing.hasBefore) document.querySelector('[data-layer="before"]')?.remove();
    if (!room.clothing.hasClearance)
      for (const name of ["clearance", "penetration"]) document.querySelector(`[data-layer="${name}"]`)?.remove();
    wire(room);
    setPlaying(true);
    play();
  } catch (error) {
    showFallback(`The 3D view cannot start here (${error.message}). It needs WebGL2; figures and tables need nothing.`);
    outcome = "failed";
  }
  window.dressedReport = { state, layers, setLayer, showFrame, setPlaying, stage };
  document.documentElement.dataset.state = outcome;
};

startReport();
