// The renderer: floor, body, curves and dots, then the capture as one translucent sheet over them.

const SHADOW_SIDE = 256;
const FLOOR_HALF = 2.6;
/** A value of the heat map that is not known. */
const UNKNOWN = -32768;

class Renderer {
  /** Throws when WebGL2 is missing. */
  constructor(canvas, body, heat) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: false });
    if (!gl) throw new Error("WebGL2 is not available");
    Object.assign(this, { canvas, gl, heatRange: heat.range });
    const vertex = bodyVertex(body.joints.length);
    this.programs = {
      body: this.program(vertex, BODY_FRAGMENT),
      bodyShadow: this.program(vertex, SHADOW_FRAGMENT),
      capture: this.program(CAPTURE_VERTEX, CAPTURE_FRAGMENT),
      captureShadow: this.program(CAPTURE_VERTEX, SHADOW_FRAGMENT),
      floor: this.program(FLOOR_VERTEX, FLOOR_FRAGMENT),
      segments: this.program(SEGMENT_VERTEX, SEGMENT_FRAGMENT),
      dots: this.program(DOT_VERTEX, DOT_FRAGMENT),
    };
    this.heatTexture = this.texture(heat.colors.length, 1, new Uint8Array(heat.colors.flatMap((c) => [...c, 255])));
    this.shadowTexture = this.texture(SHADOW_SIDE, SHADOW_SIDE, null);
    this.shadowTarget = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadowTarget);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.shadowTexture, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    this.empty = gl.createVertexArray();
    this.scratch = gl.createBuffer();
    this.captures = new Map();
    this.setBody(body);
  }

  /** Takes over a body in the place of the one before; bones and joints stay as many. */
  setBody(body) {
    const gl = this.gl;
    if (this.bodyMesh) this.discard(this.bodyMesh);
    this.body = body;
    this.clearanceBuffer = gl.createBuffer();
    this.bodyMesh = this.mesh(body.positions, body.normals, body.faces, (buffers) => {
      const [weights, bones] = [gl.createBuffer(), gl.createBuffer()];
      buffers.push(weights, bones, this.clearanceBuffer);
      this.attribute(2, weights, body.weights, 4, gl.UNSIGNED_BYTE, true);
      gl.bindBuffer(gl.ARRAY_BUFFER, bones);
      gl.bufferData(gl.ARRAY_BUFFER, body.bones, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(3);
      gl.vertexAttribIPointer(3, 4, gl.UNSIGNED_BYTE, 0, 0);
      this.attribute(4, this.clearanceBuffer, new Int16Array(body.vertexCount), 1, gl.SHORT, false);
    });
  }

  /** Gives a mesh's memory on the card back. */
  discard({ array, buffers }) {
    this.gl.deleteVertexArray(array);
    for (const buffer of buffers) this.gl.deleteBuffer(buffer);
  }

  /** Forgets the captures that were shown. */
  discardCaptures() {
    for (const mesh of this.captures.values()) this.discard(mesh);
    this.captures.clear();
    this.captureMesh = null;
  }

  program(vertex, fragment) {
    const gl = this.gl;
    const program = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const places = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      places[name.replace("[0]", "")] = gl.getUniformLocation(program, name);
    }
    return { program, places };
  }

  texture(width, height, bytes) {
    const gl = this.gl;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.LINEAR);
    for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, wrap, gl.CLAMP_TO_EDGE);
    return texture;
  }

  attribute(location, buffer, values, size, type, isShare) {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(location);
    gl.vertexAttribPointer(location, size, type, isShare, 0, 0);
  }

  mesh(positions, normals, faces, more = () => {}) {
    const gl = this.gl;
    const array = gl.createVertexArray();
    const buffers = [gl.createBuffer(), gl.createBuffer(), gl.createBuffer()];
    gl.bindVertexArray(array);
    this.attribute(0, buffers[0], positions, 3, gl.FLOAT, false);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[1]);
    gl.bufferData(gl.ARRAY_BUFFER, normals, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 3, gl.BYTE, true, 4, 0);
    more(buffers);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers[2]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    const indexType = faces instanceof Uint16Array ? gl.UNSIGNED_SHORT : gl.UNSIGNED_INT;
    return { array, buffers, count: faces.length, indexType, vertexCount: positions.length / 3 };
  }

  /** Takes over a frame: its capture goes to the card once, its clearances each time. */
  setFrame(frame, number) {
    const gl = this.gl;
    this.frame = frame;
    if (!this.captures.has(number)) this.captures.set(number, this.captureOf(frame));
    this.captureMesh = this.captures.get(number);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.clearanceBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, frame.clearance ?? new Int16Array(this.body.vertexCount).fill(UNKNOWN), gl.DYNAMIC_DRAW);
  }

  captureOf({ positions, normals, faces, captureHeat }) {
    const gl = this.gl;
    return this.mesh(positions, normals, faces, (buffers) => {
      if (!captureHeat) return;
      buffers.push(gl.createBuffer());
      this.attribute(4, buffers.at(-1), captureHeat, 1, gl.SHORT, false);
    });
  }

  use(name, values) {
    const gl = this.gl;
    const { program, places } = this.programs[name];
    gl.useProgram(program);
    for (const [key, value] of Object.entries(values)) {
      const place = places[key];
      if (place === undefined) continue;
      if (typeof value === "number") gl.uniform1f(place, value);
      else if (value.length === 16) gl.uniformMatrix4fv(place, false, value);
      else if (key === "boneRows") gl.uniform4fv(place, value);
      else gl[`uniform${value.length}fv`](place, value);
    }
  }

  drawMesh(mesh) {
    const gl = this.gl;
    gl.bindVertexArray(mesh.array);
    if (mesh.count) gl.drawElements(gl.TRIANGLES, mesh.count, mesh.indexType, 0);
    else gl.drawArrays(gl.POINTS, 0, mesh.vertexCount);
  }

  /** Draws the frame; `scene` holds camera, layers, colours, segments and dots. */
  draw(scene) {
    const gl = this.gl;
    const { view, projection, floor, layers, colors } = scene;
    if (floor) this.drawShadow(scene);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(...colors.background, 1);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    const up = [view[4], view[5], view[6]];
    const common = { view, projection, up };
    if (floor) this.drawFloor(scene);
    if (layers.body) {
      const values = { boneRows: this.frame.bones, color: colors.body, heatRange: this.heatRange, heatUnknown: UNKNOWN + 0.5, showsHeat: layers.heat ? 1 : 0 };
      gl.bindTexture(gl.TEXTURE_2D, this.heatTexture);
      this.use("body", { ...common, ...values });
      this.drawMesh(this.bodyMesh);
    }
    for (const lines of scene.lines) this.drawSegments(scene, lines);
    if (layers.capture && this.captureMesh?.vertexCount) this.drawCapture(common, scene);
    this.drawDots(scene);
  }

  /** `setBack` lets the body win where the two nearly coincide; `veil` overrides how much the capture covers. */
  drawCapture(common, { colors, layers, setBack = 0, veil: cover = layers.heat ? 0.5 : 1 }) {
    const gl = this.gl;
    const isCloud = this.captureMesh.count === 0 ? 1 : 0;
    const veil = colors.captureOpacity.map((opacity) => opacity * cover);
    const [faceOn, edgeOn] = layers.body ? veil : [1, 1];
    const heat = { heatRange: this.heatRange, heatUnknown: UNKNOWN + 0.5, showsHeat: layers.captureHeat ? 1 : 0 };
    gl.bindTexture(gl.TEXTURE_2D, this.heatTexture);
    this.use("capture", { ...common, ...heat, setBack, color: colors.capture, faceOn: isCloud ? 0.8 : faceOn, edgeOn, isCloud });
    // Depth first, colour second: only the nearest sheet of the capture is blended.
    gl.colorMask(false, false, false, false);
    this.drawMesh(this.captureMesh);
    gl.colorMask(true, true, true, true);
    gl.enable(gl.BLEND);
    this.drawMesh(this.captureMesh);
    gl.disable(gl.BLEND);
  }

  drawShadow({ floor, layers }) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadowTarget);
    gl.viewport(0, 0, SHADOW_SIDE, SHADOW_SIDE);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendEquation(gl.MAX);
    const identity = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
    const values = { view: identity, projection: overhead(floor, floor[1], FLOOR_HALF), floorHeight: floor[1], boneRows: this.frame.bones };
    if (layers.body) {
      this.use("bodyShadow", values);
      this.drawMesh(this.bodyMesh);
    }
    if (layers.capture && this.captureMesh?.count) {
      this.use("captureShadow", values);
      this.drawMesh(this.captureMesh);
    }
    gl.blendEquation(gl.FUNC_ADD);
    gl.disable(gl.BLEND);
  }

  drawFloor({ view, projection, floor, colors }) {
    const gl = this.gl;
    gl.bindTexture(gl.TEXTURE_2D, this.shadowTexture);
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    gl.bindVertexArray(this.empty);
    this.use("floor", { view, projection, center: floor, reach: FLOOR_HALF, ink: colors.ink, shadowDepth: colors.shadow });
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }

  /** Lines of constant width: six numbers a segment; `isOnTop` ignores depth. */
  drawSegments({ view, projection }, { segments, color, width, isOnTop }) {
    const gl = this.gl;
    if (!segments.length) return;
    gl.bindVertexArray(this.empty);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.scratch);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(segments), gl.DYNAMIC_DRAW);
    for (const location of [0, 1]) {
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, 3, gl.FLOAT, false, 24, 12 * location);
      gl.vertexAttribDivisor(location, 1);
    }
    const size = [this.canvas.width, this.canvas.height];
    this.use("segments", { view, projection, size, color, width });
    gl.enable(gl.BLEND);
    gl.depthFunc(isOnTop ? gl.ALWAYS : gl.LEQUAL);
    // Soft borders that wrote depth would cut into the next segment.
    gl.depthMask(false);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, segments.length / 6);
    gl.depthMask(true);
    gl.depthFunc(gl.LEQUAL);
    gl.disable(gl.BLEND);
    for (const location of [0, 1]) {
      gl.vertexAttribDivisor(location, 0);
      gl.disableVertexAttribArray(location);
    }
  }

  /** Landmarks: full where they can be seen, faint where something hides them. */
  drawDots({ view, projection, dots, colors, pixelRatio }) {
    const gl = this.gl;
    if (!dots.length) return;
    gl.bindVertexArray(this.empty);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.scratch);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(dots), gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 4, gl.FLOAT, false, 0, 0);
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    for (const [test, alpha] of [[gl.GREATER, 0.4], [gl.LEQUAL, 1]]) {
      gl.depthFunc(test);
      this.use("dots", { view, projection, width: 13 * pixelRatio, color: [...colors.landmark, alpha] });
      gl.drawArrays(gl.POINTS, 0, dots.length / 4);
    }
    gl.depthFunc(gl.LEQUAL);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    gl.disableVertexAttribArray(0);
  }
}
