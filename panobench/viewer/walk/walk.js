"use strict";
// Reads the page's data, moves the camera, and draws when something changed.

const about = JSON.parse(document.getElementById("about").textContent);
const $ = id => document.getElementById(id);
const canvas = $("view");

async function unpacked(text) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

// The columns as walk/page.py wrote them -> what the renderer wants.
function decoded(buffer, count) {
  let offset = 0;
  const column = (Kind, n) => {
    const found = new Kind(buffer, offset, n * count);
    offset += found.byteLength;
    return found;
  };
  const means = column(Float32Array, 3), scales = column(Int16Array, 3), quats = column(Int16Array, 4);
  const tints = column(Int16Array, 3), alphas = column(Uint8Array, 1);
  const covariances = new Float32Array(6 * count), colours = new Float32Array(3 * count), opacities = new Float32Array(count);
  for (let i = 0; i < count; i++) {
    const [a, b, c] = [0, 1, 2].map(k => Math.exp(2 * scales[3 * i + k] / about.scaleSteps));
    let [w, x, y, z] = [0, 1, 2, 3].map(k => quats[4 * i + k]);
    const n = 1 / Math.hypot(w, x, y, z);
    w *= n; x *= n; y *= n; z *= n;
    const R = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z),
      2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
    let o = 6 * i;
    for (const [p, q] of [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]])
      covariances[o++] = a * R[3 * p] * R[3 * q] + b * R[3 * p + 1] * R[3 * q + 1] + c * R[3 * p + 2] * R[3 * q + 2];
    for (let k = 0; k < 3; k++) colours[3 * i + k] = tints[3 * i + k] / about.colourSteps;
    opacities[i] = alphas[i] / 255;
  }
  return { count, means, covariances, colours, opacities };
}

// Matrices are nine numbers by rows, camera to world; quaternions (x, y, z, w).
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const column = (R, k) => [R[k], R[3 + k], R[6 + k]];
const plus = (a, b, s = 1) => a.map((v, k) => v + s * b[k]);
const times = (A, B) => A.map((_, i) => dot(A.slice(3 * (i / 3 | 0), 3 * (i / 3 | 0) + 3), column(B, i % 3)));
const matrix = ([x, y, z, w]) => [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z),
  1 - 2 * (x * x + z * z), 2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
const turn = (axis, angle) => matrix([...axis.map(v => v * Math.sin(angle / 2)), Math.cos(angle / 2)]);
function quaternion(R) {
  const t = [R[0] - R[4] - R[8], R[4] - R[0] - R[8], R[8] - R[0] - R[4], R[0] + R[4] + R[8]];
  const k = t.indexOf(Math.max(...t)), s = Math.sqrt(1 + t[k]);
  const q = k === 3 ? [R[7] - R[5], R[2] - R[6], R[3] - R[1], s * s]
    : k === 0 ? [s * s, R[1] + R[3], R[2] + R[6], R[7] - R[5]]
    : k === 1 ? [R[1] + R[3], s * s, R[5] + R[7], R[2] - R[6]] : [R[2] + R[6], R[5] + R[7], s * s, R[3] - R[1]];
  return q.map(v => v / (2 * s));
}
function between(a, b, t) {
  const sign = a.q.reduce((sum, v, k) => sum + v * b.q[k], 0) < 0 ? -1 : 1;
  const q = a.q.map((v, k) => (1 - t) * v + t * sign * b.q[k]), n = Math.hypot(...q);
  return { eye: a.eye.map((v, k) => (1 - t) * v + t * b.eye[k]), q: q.map(v => v / n) };
}

const unit = about.unit, up = about.up, poses = about.flight.map(p => ({ eye: p.slice(0, 3), q: p.slice(3) }));
const home = { eye: about.start.slice(0, 3), q: about.start.slice(3) };
const camera = { eye: [...home.eye], R: matrix(home.q), fov: 90 };
let renderer = null, overview = false, flying = false, at = 0, showPath = poses.length > 1, dirty = true, quality = 1, glide = null;
let before = 0, slow = 0;
const held = new Set();

function overviewPose() {
  // From above and behind, far enough for what is around the path; what lies far outside is left out.
  const { centre, radius } = about.frame, forward = matrix(home.q), flat = plus(column(forward, 2), up, -dot(column(forward, 2), up));
  const n = Math.hypot(...flat), ahead = n > 1e-6 ? flat.map(v => v / n) : column(forward, 0);
  const z = plus(ahead.map(v => 0.5 * v), up, -0.866), y = plus(up.map(v => -0.5 * v), ahead, -0.866);
  const x = [y[1] * z[2] - y[2] * z[1], y[2] * z[0] - y[0] * z[2], y[0] * z[1] - y[1] * z[0]];
  const R = [x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]];
  return { eye: plus(centre, z, -1.8 * radius), q: quaternion(R) };
}

function lines() {
  const out = [], segment = (a, b, colour) => out.push(...a, ...b, ...colour);
  if (showPath) {
    for (let k = 1; k < about.path.length; k++) segment(about.path[k - 1], about.path[k], [0.36, 0.66, 1, 0.95]);
    for (const p of about.keyframes) frustum(p, 0.05 * unit, [1, 0.68, 0.2, 0.9], segment);
    if (overview && poses.length) {
      const p = here();
      frustum([...p.eye, ...p.q], 0.12 * unit, [1, 1, 1, 1], segment);
    }
  }
  return out;
}

function frustum(p, size, colour, segment) {
  const eye = p.slice(0, 3), R = matrix(p.slice(3)), corner = (x, y) => plus(eye, [0, 1, 2].map(r => size *
    (R[3 * r] * x + R[3 * r + 1] * y + R[3 * r + 2])));
  const corners = [corner(-0.8, -0.5), corner(0.8, -0.5), corner(0.8, 0.5), corner(-0.8, 0.5)];
  corners.forEach((c, k) => { segment(eye, c, colour); segment(c, corners[(k + 1) % 4], colour); });
}

function here() {
  const i = Math.min(Math.floor(at), poses.length - 1), j = Math.min(i + 1, poses.length - 1);
  return between(poses[i], poses[j], at - i);
}

function place(pose) { camera.eye = [...pose.eye]; camera.R = matrix(pose.q); dirty = true; }

function look(yaw, pitch) {
  let R = times(turn(up, yaw), camera.R);
  const pitched = times(R, turn([1, 0, 0], pitch)), level = Math.abs(dot(column(pitched, 2), up));
  if (level < 0.995 || level < Math.abs(dot(column(R, 2), up))) R = pitched;
  camera.R = R;
  glide = null;
  fly(false);
  dirty = true;
}

function move(right, above, ahead) {
  camera.eye = plus(plus(plus(camera.eye, column(camera.R, 0), right), up, above), column(camera.R, 2), ahead);
  glide = null;
  fly(false);
  dirty = true;
}

function fly(on) {
  flying = on && poses.length > 1;
  if (flying) { leave(); if (at >= poses.length - 1) at = 0; }
  $("fly").setAttribute("aria-pressed", flying);
  $("fly").textContent = flying ? "Pause" : "Fly along the path";
  dirty = true;
}

function glideTo(pose) { glide = { from: { eye: [...camera.eye], q: quaternion(camera.R) }, to: pose, since: performance.now() }; dirty = true; }

function leave() {
  if (!overview) return;
  overview = false;
  $("overview").setAttribute("aria-pressed", false);
  renderer.setLines(lines());
}

function show(above) {
  fly(false);
  overview = above;
  $("overview").setAttribute("aria-pressed", above);
  renderer.setLines(lines());
  glideTo(above ? overviewPose() : poses.length > 1 ? here() : home);
}

function seek(value) {
  at = value;
  leave();
  if (poses.length) place(here());
  $("along").value = at;
}

function frame(now) {
  const lapse = Math.min(0.1, (now - before) / 1000);
  before = now;
  if (held.size) {
    const is = (...names) => names.some(n => held.has(n)) ? 1 : 0, step = (held.has("shift") ? 3 : 1) * unit * lapse;
    const x = is("d") - is("a"), y = is("e") - is("q"), z = is("w", "arrowup") - is("s", "arrowdown");
    const yaw = is("arrowleft") - is("arrowright");
    if (x || y || z) move(x * step, y * step, z * step);
    if (yaw) look(1.4 * lapse * yaw, 0);
  }
  if (flying) {
    at = Math.min(at + lapse * (poses.length - 1) / about.seconds, poses.length - 1);
    $("along").value = at;
    place(here());
    if (at >= poses.length - 1) fly(false);
  }
  if (glide) {
    const t = Math.min(1, (now - glide.since) / 500), pose = between(glide.from, glide.to, t * t * (3 - 2 * t));
    place(pose);
    if (t === 1) glide = null;
  }
  const busy = held.size > 0 || flying || glide !== null || pressed.size > 0;
  // Coarser pictures while it moves, where the graphics processor is too slow for full ones.
  if (busy && dirty) slow = 0.8 * slow + 0.2 * lapse;
  const wanted = !busy ? 1 : slow > 0.06 ? 0.5 : slow > 0.035 ? 0.7 : 1;
  if (wanted !== quality) { quality = wanted; dirty = true; }
  if (dirty) paint();
  requestAnimationFrame(frame);
}

function paint() {
  dirty = false;
  const ratio = Math.min(window.devicePixelRatio || 1, 2) * quality;
  const width = Math.max(2, Math.round(canvas.clientWidth * ratio)), height = Math.max(2, Math.round(canvas.clientHeight * ratio));
  renderer.resize(width, height);
  // The longer side sees camera.fov, unless the shorter one would see less than 0.72 of that: telephones held upright.
  const half = camera.fov * Math.PI / 360, long_ = Math.max(width, height), short_ = Math.min(width, height);
  const focal = Math.min(0.5 * long_ / Math.tan(half), 0.5 * short_ / Math.tan(0.72 * half));
  const inside = overview ? { ceiling: [...up, about.frame.ceiling], shell: [...about.frame.centre, about.frame.radius] } : {};
  renderer.draw({ eye: camera.eye, R: camera.R, focal, wide: 3 * ratio, ...inside }, unit, showPath);
}

const pressed = new Map();
function controls() {
  let pinch = 0;
  canvas.addEventListener("pointerdown", e => { canvas.setPointerCapture(e.pointerId); pressed.set(e.pointerId, [e.clientX, e.clientY]); });
  canvas.addEventListener("pointermove", e => {
    const last = pressed.get(e.pointerId);
    if (!last) return;
    pressed.set(e.pointerId, [e.clientX, e.clientY]);
    if (pressed.size === 1) {
      const scale = camera.fov / 57.3 / Math.max(canvas.clientWidth, canvas.clientHeight);
      look((e.clientX - last[0]) * scale, (e.clientY - last[1]) * scale);
      return;
    }
    const [a, b] = [...pressed.values()], apart = Math.hypot(a[0] - b[0], a[1] - b[1]);
    if (pinch) move(0, 0, (apart - pinch) * 0.006 * unit);
    pinch = apart;
  });
  const release = e => { pressed.delete(e.pointerId); pinch = 0; dirty = true; };
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, release);
  canvas.addEventListener("wheel", e => { e.preventDefault(); move(0, 0, -0.0015 * e.deltaY * unit); }, { passive: false });
  canvas.addEventListener("keydown", e => {
    const key = e.key.toLowerCase();
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    if ("wasdqe".includes(key) || key.startsWith("arrow") || key === "shift") { held.add(key); e.preventDefault(); }
    else if (key === "+" || key === "-") { camera.fov = Math.min(120, Math.max(30, camera.fov + (key === "+" ? -8 : 8))); dirty = true; }
    else if (key === " ") { fly(!flying); e.preventDefault(); }
  });
  canvas.addEventListener("keyup", e => held.delete(e.key.toLowerCase()));
  canvas.addEventListener("blur", () => held.clear());
  window.addEventListener("resize", () => { if (overview) place(overviewPose()); dirty = true; });
  $("fly").onclick = () => fly(!flying);
  $("start").onclick = () => { fly(false); at = 0; $("along").value = 0; leave(); glideTo(home); };
  $("overview").onclick = () => show(!overview);
  $("path").onclick = () => { showPath = !showPath; $("path").setAttribute("aria-pressed", showPath); renderer.setLines(lines()); dirty = true; };
  $("along").oninput = e => { fly(false); glide = null; seek(Number(e.target.value)); };
}

async function begin() {
  const map = decoded(await unpacked($("map").textContent.trim()), about.count);
  renderer = new SplatRenderer(canvas, map);
  for (const id of ["fly", "along", "path"]) $(id).hidden = poses.length < 2;
  $("along").max = Math.max(0, poses.length - 1);
  $("path").setAttribute("aria-pressed", showPath);
  renderer.setLines(lines());
  controls();
  $("wait").hidden = true;
  requestAnimationFrame(frame);
}

const WALK = { ready: false, camera, place, show, seek, paint, canvas, get renderer() { return renderer; } };
begin().then(() => { WALK.ready = true; }, error => {
  $("wait").textContent = `The map cannot be shown: ${error.message}`;
  console.error(error.message);
});
