// Shaders. Surfaces are lit by a key and a fill lamp that stand beside the camera, as in the still pictures.

const STUDIO = `
vec3 toLinear(vec3 c) { return pow(c, vec3(2.2)); }
vec3 toScreen(vec3 c) { return pow(clamp(c, 0.0, 1.0), vec3(1.0 / 2.2)); }
vec3 lit(vec3 albedo, vec3 normal, vec3 towardEye, vec3 up) {
  vec3 key = normalize(vec3(-0.65, 0.75, 0.75));
  vec3 fill = normalize(vec3(0.9, 0.1, 0.6));
  float keyLight = 0.84 * pow(max((dot(normal, key) + 0.15) / 1.15, 0.0), 1.2);
  float fillLight = 0.26 * max((dot(normal, fill) + 0.4) / 1.4, 0.0);
  float sky = 0.23 + 0.12 * dot(normal, up);
  float gloss = 0.06 * pow(max(dot(normal, normalize(key + towardEye)), 0.0), 24.0);
  return toLinear(albedo) * (keyLight + fillLight + sky) + vec3(gloss);
}`;

/** Colour of a signed value of the heat map; what is not known is grey. */
const HEAT = `
in float heat;
uniform vec2 heatRange;
uniform float showsHeat, heatUnknown;
uniform sampler2D heatColors;
vec3 heated(vec3 color) {
  if (showsHeat < 0.5) return color;
  float share = (heat - heatRange.x) / (heatRange.y - heatRange.x);
  return heat < heatUnknown ? vec3(0.5) : texture(heatColors, vec2(clamp(share, 0.002, 0.998), 0.5)).rgb;
}`;

const bodyVertex = (boneCount) => `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec4 weights;
layout(location = 3) in uvec4 bones;
layout(location = 4) in float clearance;
uniform vec4 boneRows[${boneCount * 3}];
uniform mat4 view, projection;
out vec3 viewNormal, viewPosition;
out float heat, height;
void main() {
  vec4 rows[3] = vec4[3](vec4(0.0), vec4(0.0), vec4(0.0));
  float total = max(weights.x + weights.y + weights.z + weights.w, 1e-6);
  for (int k = 0; k < 4; k++)
    for (int row = 0; row < 3; row++) rows[row] += weights[k] / total * boneRows[int(bones[k]) * 3 + row];
  vec4 rest = vec4(position, 1.0);
  vec3 posed = vec3(dot(rows[0], rest), dot(rows[1], rest), dot(rows[2], rest));
  vec3 turned = vec3(dot(rows[0].xyz, normal), dot(rows[1].xyz, normal), dot(rows[2].xyz, normal));
  vec4 seen = view * vec4(posed, 1.0);
  viewNormal = mat3(view) * turned;
  viewPosition = seen.xyz;
  heat = clearance;
  height = posed.y;
  gl_Position = projection * seen;
}`;

const BODY_FRAGMENT = `#version 300 es
precision highp float;
in vec3 viewNormal, viewPosition;
uniform vec3 color, up;
out vec4 pixel;
${STUDIO}
${HEAT}
void main() {
  vec3 towardEye = normalize(-viewPosition);
  vec3 n = normalize(viewNormal);
  if (!gl_FrontFacing) n = -n;
  pixel = vec4(toScreen(lit(heated(color), n, towardEye, up)), 1.0);
}`;

const CAPTURE_VERTEX = `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 4) in float clearance;
uniform mat4 view, projection;
uniform float setBack;
out vec3 viewNormal, viewPosition;
out float heat, height;
void main() {
  vec4 seen = view * vec4(position, 1.0);
  viewNormal = mat3(view) * normal;
  viewPosition = seen.xyz;
  heat = clearance;
  height = position.y;
  gl_Position = projection * seen;
  gl_Position.z += setBack * gl_Position.w;
  gl_PointSize = 2.0;
}`;

const CAPTURE_FRAGMENT = `#version 300 es
precision highp float;
in vec3 viewNormal, viewPosition;
uniform vec3 color, up;
uniform float faceOn, edgeOn, isCloud;
out vec4 pixel;
${STUDIO}
${HEAT}
void main() {
  vec3 towardEye = normalize(-viewPosition);
  vec3 n = isCloud > 0.5 ? towardEye : normalize(viewNormal);
  if (dot(n, towardEye) < 0.0) n = -n;
  float edge = pow(1.0 - clamp(dot(n, towardEye), 0.0, 1.0), 2.0);
  pixel = vec4(toScreen(lit(heated(color), n, towardEye, up)), mix(faceOn, edgeOn, edge));
}`;

/** Darkness that a surface at some height throws on the floor. */
const SHADOW_FRAGMENT = `#version 300 es
precision highp float;
in float height;
uniform float floorHeight;
out vec4 pixel;
void main() { pixel = vec4(exp(-max(height - floorHeight, 0.0) / 0.35)); }`;

const FLOOR_VERTEX = `#version 300 es
uniform mat4 view, projection;
uniform vec3 center;
uniform float reach;
out vec2 place;
void main() {
  place = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  gl_Position = projection * view * vec4(center.x + place.x * reach, center.y, center.z + place.y * reach, 1.0);
}`;

const FLOOR_FRAGMENT = `#version 300 es
precision highp float;
in vec2 place;
uniform vec3 center, ink;
uniform float reach, shadowDepth;
uniform sampler2D shadow;
out vec4 pixel;
void main() {
  float fade = 1.0 - smoothstep(0.25, 1.0, length(place));
  vec2 metres = (center.xz + place * reach) * 2.0;
  vec2 width = fwidth(metres) * 1.1;
  vec2 line = 1.0 - smoothstep(vec2(0.0), width, abs(fract(metres - 0.5) - 0.5));
  float grid = 0.16 * max(line.x, line.y) * fade;
  float dark = 0.0;
  for (int y = -3; y <= 3; y++)
    for (int x = -3; x <= 3; x++) {
      vec2 at = vec2(place.x, -place.y) * 0.5 + 0.5 + vec2(x, y) * 0.007;
      dark += texture(shadow, at).r * exp(-0.14 * float(x * x + y * y));
    }
  float darkness = shadowDepth * clamp(dark / 21.0, 0.0, 1.0) * fade;
  float alpha = 1.0 - (1.0 - grid) * (1.0 - darkness);
  pixel = vec4(mix(ink, vec3(0.0), darkness / max(alpha, 1e-4)), alpha);
}`;

/** A segment as a strip of constant width on the screen. */
const SEGMENT_VERTEX = `#version 300 es
layout(location = 0) in vec3 start;
layout(location = 1) in vec3 end;
uniform mat4 view, projection;
uniform vec2 size;
uniform float width;
out vec2 along;
out float span;
void main() {
  vec4 a = projection * view * vec4(start, 1.0);
  vec4 b = projection * view * vec4(end, 1.0);
  vec2 pa = a.xy / a.w * size * 0.5, pb = b.xy / b.w * size * 0.5;
  vec2 direction = pb - pa;
  span = max(length(direction), 1e-4);
  direction /= span;
  bool isEnd = gl_VertexID >= 2;
  float side = (gl_VertexID & 1) == 0 ? -1.0 : 1.0;
  vec2 offset = direction * (isEnd ? 1.0 : -1.0) + vec2(-direction.y, direction.x) * side;
  along = vec2(isEnd ? span + width : -width, side * width);
  gl_Position = isEnd ? b : a;
  gl_Position.xy += offset * width / (size * 0.5) * gl_Position.w;
  gl_Position.z -= 0.0006 * gl_Position.w;
}`;

const SEGMENT_FRAGMENT = `#version 300 es
precision highp float;
in vec2 along;
in float span;
uniform vec4 color;
uniform float width;
out vec4 pixel;
void main() {
  vec2 beyond = vec2(along.x - clamp(along.x, 0.0, span), along.y);
  float cover = clamp(width - length(beyond), 0.0, 1.0);
  if (cover <= 0.0) discard;
  pixel = vec4(color.rgb, color.a * cover);
}`;

const DOT_VERTEX = `#version 300 es
layout(location = 0) in vec4 mark;
uniform mat4 view, projection;
uniform float width;
out float trust;
void main() {
  gl_Position = projection * view * vec4(mark.xyz, 1.0);
  gl_Position.z -= 0.001 * gl_Position.w;
  gl_PointSize = width;
  trust = mark.w;
}`;

const DOT_FRAGMENT = `#version 300 es
precision highp float;
in float trust;
uniform vec4 color;
uniform float width;
out vec4 pixel;
void main() {
  float radius = length(gl_PointCoord - 0.5) * width;
  float cover = clamp(width * 0.5 - radius, 0.0, 1.0);
  float ring = clamp(radius - (width * 0.5 - 2.5), 0.0, 1.0);
  if (cover <= 0.0) discard;
  vec3 filling = mix(vec3(0.75), color.rgb, clamp(trust, 0.0, 1.0));
  pixel = vec4(mix(filling, vec3(1.0), ring), color.a * cover);
}`;
