// Binary blocks of the page: base64 text in script elements, laid out as src/report/blocks.rs says.

const readBlock = (id) => {
  const text = atob(document.getElementById(id).textContent);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes.buffer;
};

/** Takes typed arrays one after the other; every part ends on a multiple of four bytes. */
class BlockReader {
  constructor(buffer) {
    this.buffer = buffer;
    this.offset = 0;
  }
  take(Type, count) {
    const part = new Type(this.buffer, this.offset, count);
    this.offset += Math.ceil(part.byteLength / 4) * 4;
    return part;
  }
  faces(faceCount, vertexCount) {
    return this.take(vertexCount <= 65536 ? Uint16Array : Uint32Array, faceCount * 3);
  }
}

/** Area-weighted vertex normals as signed bytes, four a vertex. */
const vertexNormals = (positions, faces) => {
  const sums = new Float32Array(positions.length);
  for (let f = 0; f < faces.length; f += 3) {
    const [a, b, c] = [faces[f] * 3, faces[f + 1] * 3, faces[f + 2] * 3];
    const ux = positions[b] - positions[a], uy = positions[b + 1] - positions[a + 1], uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a], vy = positions[c + 1] - positions[a + 1], vz = positions[c + 2] - positions[a + 2];
    const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
    for (const i of [a, b, c]) {
      sums[i] += nx;
      sums[i + 1] += ny;
      sums[i + 2] += nz;
    }
  }
  const normals = new Int8Array((positions.length / 3) * 4);
  for (let v = 0; v < positions.length / 3; v++) {
    const length = Math.hypot(sums[3 * v], sums[3 * v + 1], sums[3 * v + 2]) || 1;
    for (let k = 0; k < 3; k++) normals[4 * v + k] = Math.round((127 * sums[3 * v + k]) / length);
  }
  return normals;
};

const readBody = (head) => {
  const reader = new BlockReader(readBlock("block-body"));
  const positions = reader.take(Float32Array, head.vertexCount * 3);
  const weights = reader.take(Uint8Array, head.vertexCount * 4);
  const bones = reader.take(Uint8Array, head.vertexCount * 4);
  const faces = reader.faces(head.faceCount, head.vertexCount);
  return { ...head, positions, weights, bones, faces, normals: vertexNormals(positions, faces) };
};

const readFrame = (head, number, body) => {
  const reader = new BlockReader(readBlock(`block-frame-${number}`));
  const bones = reader.take(Float32Array, body.joints.length * 12);
  const millimetres = head.hasClearance ? reader.take(Int8Array, body.vertexCount) : null;
  const clearance = millimetres && Int16Array.from(millimetres, (value) => (value === -128 ? UNKNOWN : value));
  const quantized = reader.take(Uint16Array, head.captureVertexCount * 3);
  const faces = reader.faces(head.captureFaceCount, head.captureVertexCount);
  const positions = new Float32Array(quantized.length);
  for (let i = 0; i < quantized.length; i++)
    positions[i] = head.captureLow[i % 3] + (quantized[i] / 65535) * head.captureSize[i % 3];
  return { ...head, bones, clearance, positions, faces, normals: vertexNormals(positions, faces) };
};

/** A point at rest moved by one bone's rows of 3 × 4. */
const moved = (bones, bone, [x, y, z]) => {
  const m = bones.subarray(bone * 12, bone * 12 + 12);
  return [m[0] * x + m[1] * y + m[2] * z + m[3], m[4] * x + m[5] * y + m[6] * z + m[7], m[8] * x + m[9] * y + m[10] * z + m[11]];
};

/** A point at rest moved with the skin of a body vertex. */
const skinned = (body, bones, vertex, point) => {
  let sum = [0, 0, 0];
  let total = 0;
  for (let k = 4 * vertex; k < 4 * vertex + 4; k++) {
    if (!body.weights[k]) continue;
    total += body.weights[k];
    sum = add(sum, scale(moved(bones, body.bones[k], point), body.weights[k]));
  }
  return scale(sum, 1 / (total || 1));
};
