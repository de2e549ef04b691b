// SPDX-License-Identifier: Apache-2.0
// What the GPU runs: a Gaussian to where its bones carry it, its ellipse in the picture, and its share of a pixel.
// The formulas are those of body/avatar/posing.py and splatting/cpu/projection.py.

const SPLAT_VERTEX = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D; precision highp usampler2D;
uniform sampler2D means, turns, scales, colours, harmonics, changes, bones, sets;
uniform usampler2D skins, order;
uniform mat3 camera;                 // camera_from_world
uniform vec3 offset, eye;
uniform vec2 focal, principal, size;
uniform vec4 limits;                 // tangents left, right, top, bottom beyond which the projection is not linearised
uniform float near, dilation, faintest;
uniform int bands;                   // texels of a Gaussian's harmonics
uniform bool classes, changing;
flat out vec3 colour;
flat out vec4 ellipse;               // A, k, c, log2 of the opacity
flat out vec2 middle;
const float HALF_LOG2_E = 0.7213475204444817, C0 = 0.28209479177387814, C1 = 0.4886025119029199;

vec4 texel(sampler2D from, int at) { return texelFetch(from, ivec2(at % ${ROW}, at / ${ROW}), 0); }

mat3 rotation(vec4 q) {
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
              2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
              2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

// Rotation and place of a bone: three texels hold its rows.
void bone(int index, out mat3 linear, out vec3 place) {
  vec4 r0 = texelFetch(bones, ivec2(0, index), 0), r1 = texelFetch(bones, ivec2(1, index), 0);
  vec4 r2 = texelFetch(bones, ivec2(2, index), 0);
  linear = transpose(mat3(r0.xyz, r1.xyz, r2.xyz));
  place = vec3(r0.w, r1.w, r2.w);
}

// The rotation nearest to a blend of rotations, by Newton's iteration; a collapsed blend has none: then the strongest
// bone decides.
mat3 polar(mat3 x, mat3 strongest) {
  for (int i = 0; i < 40; i++) {
    if (!(determinant(x) > 1e-6)) return strongest;
    mat3 next = 0.5 * (x + transpose(inverse(x))), gone = next - x;
    x = next;
    if (dot(gone[0], gone[0]) + dot(gone[1], gone[1]) + dot(gone[2], gone[2]) < 1e-10) break;
  }
  return x;
}

vec3 band(int at, float reach) {
  int width = textureSize(harmonics, 0).x;
  return (texelFetch(harmonics, ivec2(at % width, at / width), 0).rgb * 2.0 - 1.0) * reach;
}

vec3 fromHarmonics(int first, int count, float reach, vec3 d) {
  float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
  vec3 sum = C1 * (-y * band(first, reach) + z * band(first + 1, reach) - x * band(first + 2, reach));
  if (count > 3) sum += 1.0925484305920792 * (x * y * band(first + 3, reach) - y * z * band(first + 4, reach)
      - x * z * band(first + 6, reach)) + 0.31539156525252005 * (2.0 * zz - xx - yy) * band(first + 5, reach)
      + 0.5462742152960396 * (xx - yy) * band(first + 7, reach);
  if (count > 8) sum += -0.5900435899266435 * (y * (3.0 * xx - yy) * band(first + 8, reach)
      + x * (xx - 3.0 * yy) * band(first + 14, reach)) + 2.890611442640554 * x * y * z * band(first + 9, reach)
      - 0.4570457994644658 * (4.0 * zz - xx - yy) * (y * band(first + 10, reach) + x * band(first + 12, reach))
      + 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * band(first + 11, reach)
      + 1.445305721320277 * z * (xx - yy) * band(first + 13, reach);
  return sum;
}

void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);  // nowhere
  int place = gl_VertexID >> 2, id = int(texelFetch(order, ivec2(place % ${ROW}, place / ${ROW}), 0).x);
  vec4 held = texel(means, id), size_class = texel(scales, id);
  int marked = int(size_class.w);
  vec4 set = texelFetch(sets, ivec2(marked / 4, 0), 0);  // bones or not, measured now or not, bands, reach of harmonics
  vec3 size_m = size_class.xyz * texelFetch(sets, ivec2(marked / 4, 1), 0).x;
  vec3 mean = held.xyz;
  mat3 turn = mat3(1.0);
  if (set.x > 0.5) {
    uvec4 skin = texelFetch(skins, ivec2(id % ${ROW}, id / ${ROW}), 0);
    mat3 linear = mat3(0.0), own, strongest;
    vec3 moved = vec3(0.0), place;
    uint most = 0u;
    for (int k = 0; k < 4; k++) {
      uint share = skin[k] >> 8u;
      if (share == 0u) continue;
      bone(int(set.x) - 1 + int(skin[k] & 255u), own, place);
      linear += (float(share) / 255.0) * own;
      moved += (float(share) / 255.0) * place;
      if (share > most) { most = share; strongest = own; }
    }
    mean = linear * mean + moved;
    turn = most == 255u ? strongest : polar(linear, strongest);
  }
  vec3 p = camera * mean + offset;
  if (!(p.z > near)) return;
  vec4 change = changing ? texel(changes, id) : vec4(set.x > 0.5 ? 0.0 : 1.0, 0.0, 0.0, 0.0);
  float opacity = held.w;
  if (set.x > 0.5 && change.w != 0.0) opacity = 1.0 / (1.0 + (1.0 - opacity) / max(opacity, 1e-12) * exp(-change.w));
  float strength = log2(max(opacity, 1e-12)), reach = strength - faintest;
  if (reach < 0.0) return;
  vec2 tangent = p.xy / p.z;
  middle = focal * tangent + principal;
  tangent = clamp(tangent, limits.xz, limits.yw);
  mat3 axes = turn * rotation(texel(turns, id));
  vec3 row0 = vec3(camera[0].x, camera[1].x, camera[2].x), row1 = vec3(camera[0].y, camera[1].y, camera[2].y);
  vec3 row2 = vec3(camera[0].z, camera[1].z, camera[2].z);
  vec3 a = ((focal.x / p.z) * (row0 - tangent.x * row2) * axes) * size_m;
  vec3 b = ((focal.y / p.z) * (row1 - tangent.y * row2) * axes) * size_m;
  vec3 across = cross(a, b);
  float aa = dot(a, a), bb = dot(b, b), xx = aa + dilation, yy = bb + dilation, xy = dot(a, b);
  float area = dot(across, across) + dilation * (aa + bb) + dilation * dilation;  // a sum of squares: nothing cancels
  ellipse = vec4(HALF_LOG2_E * yy / area, xy / yy, HALF_LOG2_E / yy, strength);
  if (classes) {
    int level = marked % 4;
    if (set.y < 0.5) level = max(level, 1);
    colour = vec3(level == 0, level == 1, level == 2);
  } else {
    colour = 0.5 + C0 * texel(colours, id).rgb;
    if (set.z > 0.5) colour += fromHarmonics(id * bands, int(set.z), set.w, normalize(mean - eye) * turn);
    colour = max(set.x > 0.5 ? colour + C0 * change.rgb : colour * change.x, 0.0);
  }
  // A quad along the ellipse's own axes, as far as a pixel can still be touched.
  float half_gap = 0.5 * (xx - yy), apart = sqrt(half_gap * half_gap + xy * xy);
  float long_ = 0.5 * (xx + yy) + apart, short_ = area / long_;
  vec2 along = abs(xy) < 1e-9 ? (xx >= yy ? vec2(1.0, 0.0) : vec2(0.0, 1.0)) : normalize(vec2(xy, apart - half_gap));
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1 & 1) * 2.0 - 1.0;
  float radius = sqrt(reach / HALF_LOG2_E);
  vec2 pixel = middle + radius * (corner.x * sqrt(long_) * along + corner.y * sqrt(short_) * vec2(-along.y, along.x));
  gl_Position = vec4(pixel / size * 2.0 - 1.0, 0.0, 1.0);
}`;

const SPLAT_FRAGMENT = `#version 300 es
precision highp float;
flat in vec3 colour; flat in vec4 ellipse; flat in vec2 middle;
uniform float faintest, strongest;
out vec4 pixel;
void main() {
  vec2 d = gl_FragCoord.xy - middle;
  float u = d.x - ellipse.y * d.y, power = ellipse.w - ellipse.x * u * u - ellipse.z * d.y * d.y;
  if (!(power >= faintest)) discard;
  float alpha = min(exp2(power), strongest);
  pixel = vec4(colour * alpha, alpha);
}`;

const SHOW_VERTEX = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;

// The picture to the screen, upright: as bright as a camera saw it, or tinted by what it is based on.
const SHOW_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D picture, shares;
uniform vec2 size, corner;
uniform vec3 exposure;
uniform bool tinted, hurried;
out vec4 pixel;
void main() {
  vec2 own = gl_FragCoord.xy - corner, at = vec2(own.x, size.y - own.y) / size;
  vec4 seen = textureLod(picture, at, 0.0);
  // Where Gaussians were left out, what lies around them shows through, from ever further away.
  for (float level = 2.0; hurried && level < 8.0; level++) seen += (1.0 - seen.a) * textureLod(picture, at, level);
  if (hurried) seen.rgb /= max(seen.a, 0.1);
  vec3 rgb = clamp(seen.rgb, 0.0, 1.0);
  if (tinted) {
    vec3 share = texture(shares, at).rgb;
    bool invented = share.r + share.g + share.b < 0.5 || (share.b > share.r && share.b > share.g);
    vec3 tint = invented ? vec3(200, 80, 70) : share.r >= share.g ? vec3(70, 130, 180) : vec3(240, 200, 80);
    rgb = 0.5 * vec3((rgb.r + rgb.g + rgb.b) / 3.0) + 0.5 * tint / 255.0;
  } else rgb *= exposure;
  pixel = vec4(rgb, 1.0);
}`;
