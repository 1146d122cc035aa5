"use strict";
// The renderer. Footprints are those of panobench's own: exact on the tangent plane of the unit sphere around the eye,
// so that wide views and Gaussians beside the eye keep their shape. World axes are the map's; a camera looks along z,
// with x right and y down.

// Uniform over the sphere: a Gaussian of covariance C at distance d has covariance E C E^T / d^2 + low-pass there.
const SPLAT_VERTEX = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D;
layout(location = 0) in uint index;
uniform sampler2D data;
uniform mat3 toCamera; uniform vec3 eye; uniform vec2 focal; uniform float low, near;
uniform vec4 ceiling, shell;
out vec2 offset; flat out vec4 colour; flat out float cut;
const float OFFSET_MAX = 9.95;
vec4 at(int k) { int i = int(index) * 4 + k, w = textureSize(data, 0).x; return texelFetch(data, ivec2(i % w, i / w), 0); }
void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  vec4 a = at(0), b = at(1), c = at(2), d = at(3);
  vec3 away = a.xyz - eye;
  float dist = length(away);
  if (dist < near || dot(ceiling.xyz, a.xyz) > ceiling.w || distance(a.xyz, shell.xyz) > shell.w) return;
  vec3 m = away / dist;
  vec3 e = normalize(abs(m.y) < 0.9 ? cross(vec3(0.0, 1.0, 0.0), m) : cross(vec3(1.0, 0.0, 0.0), m));
  vec3 s = cross(m, e);
  mat3 C = mat3(b.x, b.y, b.z, b.y, b.w, c.x, b.z, c.x, c.y);
  vec3 Ce = C * e, Cs = C * s;
  float S00 = dot(e, Ce) / (dist * dist) + low, S01 = dot(s, Ce) / (dist * dist), S11 = dot(s, Cs) / (dist * dist) + low;
  cut = 2.0 * log(255.0 * a.w);
  if (cut <= 0.0) return;
  float mean = 0.5 * (S00 + S11), spread = length(vec2(0.5 * (S00 - S11), S01));
  vec2 axis = spread < 1e-12 ? vec2(1.0, 0.0) : normalize(abs(S01) > 1e-12 * mean
    ? vec2(S01, mean + spread - S00) : (S00 >= S11 ? vec2(1.0, 0.0) : vec2(0.0, 1.0)));
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  float k = sqrt(cut), long_ = sqrt(mean + spread), short_ = sqrt(max(mean - spread, 0.1 * low));
  vec2 size = min(vec2(long_, short_) * k, vec2(OFFSET_MAX));
  offset = corner * size / vec2(long_, short_);
  vec2 p = corner.x * size.x * axis + corner.y * size.y * vec2(-axis.y, axis.x);
  vec3 ray = toCamera * (m + p.x * e + p.y * s);
  gl_Position = vec4(focal.x * ray.x, -focal.y * ray.y, 0.0, ray.z);
  colour = vec4(c.z, c.w, d.x, a.w);
}`;
const SPLAT_FRAGMENT = `#version 300 es
precision highp float;
in vec2 offset; flat in vec4 colour; flat in float cut; out vec4 result;
void main() {
  float q = dot(offset, offset);
  if (q > cut) discard;
  float alpha = min(0.99, colour.a * exp(-0.5 * q));
  if (alpha < 1.0 / 255.0) discard;
  result = vec4(colour.rgb * alpha, alpha);
}`;
const SCREEN_VERTEX = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }`;
const SCREEN_FRAGMENT = `#version 300 es
precision highp float; uniform sampler2D picture; uniform vec3 background; uniform vec2 size; out vec4 result;
void main() {
  vec4 light = texture(picture, gl_FragCoord.xy / size);
  result = vec4(clamp(light.rgb + (1.0 - light.a) * background, 0.0, 1.0), 1.0);
}`;
const LINE_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 from; layout(location = 1) in vec3 to; layout(location = 2) in vec4 tint;
uniform mat3 toCamera; uniform vec3 eye; uniform vec2 focal, size; uniform float wide, near;
out vec4 colour;
void main() {
  vec3 a = toCamera * (from - eye), b = toCamera * (to - eye);
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  if (max(a.z, b.z) < near) return;
  if (a.z < near) a = mix(a, b, (near - a.z) / (b.z - a.z));
  if (b.z < near) b = mix(b, a, (near - b.z) / (a.z - b.z));
  vec2 p = focal * vec2(a.x, -a.y) / a.z, q = focal * vec2(b.x, -b.y) / b.z, along = (q - p) * size;
  float far = length(along);
  vec2 side = far < 1e-6 ? vec2(0.0) : vec2(-along.y, along.x) / far * wide / size;
  bool end = (gl_VertexID & 1) == 1;
  gl_Position = vec4((end ? q : p) + (gl_VertexID >> 1 == 1 ? side : -side), 0.0, 1.0);
  colour = tint * smoothstep(near, 6.0 * near, end ? b.z : a.z);
}`;
const LINE_FRAGMENT = `#version 300 es
precision highp float; in vec4 colour; out vec4 result;
void main() { result = vec4(colour.rgb * colour.a, colour.a); }`;

class SplatRenderer {
  // map: {count, means, covariances (6 each), colours, opacities}
  constructor(canvas, map) {
    const gl = this.gl = canvas.getContext("webgl2", { antialias: false, alpha: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This page needs WebGL 2.");
    this.canvas = canvas;
    this.map = map;
    this.background = [0.063, 0.086, 0.114];
    this.half = gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float");
    this.splats = this.program(SPLAT_VERTEX, SPLAT_FRAGMENT);
    this.screen = this.program(SCREEN_VERTEX, SCREEN_FRAGMENT);
    this.lines = this.program(LINE_VERTEX, LINE_FRAGMENT);
    this.upload();
    this.order = new Uint32Array(map.count);
    this.sortedAt = null;
    this.target = { width: 0, height: 0, texture: gl.createTexture(), frame: gl.createFramebuffer() };
    this.segments = { count: 0, array: gl.createVertexArray(), buffer: gl.createBuffer() };
  }

  program(vertex, fragment) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) || "shader");
    const uniforms = {};
    for (let k = 0; k < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); k++) {
      const name = gl.getActiveUniform(program, k).name;
      uniforms[name] = gl.getUniformLocation(program, name);
    }
    return { program, uniforms };
  }

  // Four texels per Gaussian: mean and opacity; covariance (xx, xy, xz, yy; yz, zz); colour.
  upload() {
    const gl = this.gl, { count, means, covariances: C, colours, opacities } = this.map;
    const width = 2048, height = Math.max(1, Math.ceil(4 * count / width)), data = new Float32Array(4 * width * height);
    for (let i = 0; i < count; i++) {
      const o = 16 * i, m = 3 * i, c = 6 * i;
      data[o] = means[m]; data[o + 1] = means[m + 1]; data[o + 2] = means[m + 2]; data[o + 3] = opacities[i];
      for (let k = 0; k < 6; k++) data[o + 4 + k] = C[c + k];
      data[o + 10] = colours[m]; data[o + 11] = colours[m + 1]; data[o + 12] = colours[m + 2];
    }
    this.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, data);
    this.nearest(gl.TEXTURE_2D);
    this.indices = gl.createBuffer();
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.indices);
    gl.bufferData(gl.ARRAY_BUFFER, 4 * count, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
  }

  nearest(kind) {
    const gl = this.gl;
    for (const name of ["MIN", "MAG"]) gl.texParameteri(kind, gl[`TEXTURE_${name}_FILTER`], gl.NEAREST);
    for (const name of ["S", "T"]) gl.texParameteri(kind, gl[`TEXTURE_WRAP_${name}`], gl.CLAMP_TO_EDGE);
  }

  // Farthest first, by distance: turning the head does not change the order. A counting sort over 16 bits.
  sort(eye) {
    const { count, means } = this.map, keys = this.keys || (this.keys = new Float32Array(count));
    let low = Infinity, high = 0;
    for (let i = 0, m = 0; i < count; i++, m += 3) {
      const x = means[m] - eye[0], y = means[m + 1] - eye[1], z = means[m + 2] - eye[2];
      const key = keys[i] = Math.log(1e-6 + x * x + y * y + z * z);
      if (key < low) low = key;
      if (key > high) high = key;
    }
    const bins = new Uint32Array(65537), scale = 65535 / Math.max(high - low, 1e-9);
    for (let i = 0; i < count; i++) bins[1 + (65535 - ((keys[i] - low) * scale | 0))]++;
    for (let b = 0; b < 65536; b++) bins[b + 1] += bins[b];
    for (let i = 0; i < count; i++) this.order[bins[65535 - ((keys[i] - low) * scale | 0)]++] = i;
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.indices);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, this.order);
    this.sortedAt = [...eye];
  }

  // segments: [x, y, z, x, y, z, r, g, b, a] each
  setLines(segments) {
    const gl = this.gl, s = this.segments;
    s.count = segments.length / 10;
    gl.bindVertexArray(s.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, s.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(segments), gl.DYNAMIC_DRAW);
    for (const [place, size, offset] of [[0, 3, 0], [1, 3, 12], [2, 4, 24]]) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, gl.FLOAT, false, 40, offset);
      gl.vertexAttribDivisor(place, 1);
    }
  }

  resize(width, height) {
    const gl = this.gl, t = this.target;
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    if (t.width === width && t.height === height) return;
    t.width = width;
    t.height = height;
    gl.bindTexture(gl.TEXTURE_2D, t.texture);
    if (this.half) gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, width, height, 0, gl.RGBA, gl.HALF_FLOAT, null);
    else gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
    this.nearest(gl.TEXTURE_2D);
    gl.bindFramebuffer(gl.FRAMEBUFFER, t.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, t.texture, 0);
  }

  // camera: {eye, R: camera to world, nine numbers by rows, focal: pixels, ceiling: [x, y, z, height], shell: [x, y, z, radius]}
  draw(camera, unit, withLines) {
    const gl = this.gl, t = this.target, { eye, R, focal } = camera, { width, height } = t;
    const moved = this.sortedAt && Math.hypot(...eye.map((v, k) => v - this.sortedAt[k]));
    if (moved === null || moved > 1e-4 * unit) this.sort(eye);
    const f = [2 * focal / width, 2 * focal / height];
    gl.bindFramebuffer(gl.FRAMEBUFFER, t.frame);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    let u = this.use(this.splats, camera, f);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.uniform1i(u.data, 0);
    gl.uniform1f(u.low, 0.3 / (focal * focal));
    gl.uniform1f(u.near, 0.01);
    gl.uniform4fv(u.ceiling, camera.ceiling || [0, 0, 0, 1e30]);
    gl.uniform4fv(u.shell, camera.shell || [0, 0, 0, 1e30]);
    gl.bindVertexArray(this.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.map.count);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.BLEND);
    u = this.use(this.screen, camera, f);
    gl.bindTexture(gl.TEXTURE_2D, t.texture);
    gl.uniform1i(u.picture, 0);
    gl.uniform3fv(u.background, this.background);
    gl.uniform2f(u.size, width, height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    if (!withLines || !this.segments.count) return;
    gl.enable(gl.BLEND);
    u = this.use(this.lines, camera, f);
    gl.uniform2f(u.size, width, height);
    gl.uniform1f(u.wide, camera.wide || 3);
    gl.uniform1f(u.near, 0.05 * unit);
    gl.bindVertexArray(this.segments.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.segments.count);
  }

  use({ program, uniforms }, { eye, R }, focal) {
    const gl = this.gl;
    gl.useProgram(program);
    if (uniforms.toCamera) gl.uniformMatrix3fv(uniforms.toCamera, false, R); // rows of camera-to-world, read by columns
    if (uniforms.eye) gl.uniform3fv(uniforms.eye, eye);
    if (uniforms.focal) gl.uniform2fv(uniforms.focal, focal);
    return uniforms;
  }
}
