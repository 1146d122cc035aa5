PB.pano = (() => {
  const VERTEX = `#version 300 es
    in vec2 p; void main() { gl_Position = vec4(p, 0.0, 1.0); }`;
  const FRAGMENT = `#version 300 es
    precision highp float;
    uniform sampler2D truth, render, cover;
    uniform vec2 size; uniform float yaw, pitch, spread, divide; uniform int mode; uniform bool covered;
    out vec4 colour;
    const float PI = 3.14159265358979;
    void main() {
      vec2 p = (gl_FragCoord.xy / size.x - 0.5 * vec2(1.0, size.y / size.x)) * 2.0 * tan(0.5 * spread);
      vec3 d = normalize(vec3(p, 1.0));
      float c = cos(pitch), s = sin(pitch);
      d = vec3(d.x, c * d.y + s * d.z, c * d.z - s * d.y);
      c = cos(yaw); s = sin(yaw);
      d = vec3(c * d.x + s * d.z, d.y, c * d.z - s * d.x);
      vec2 uv = vec2(atan(d.x, d.z) / (2.0 * PI) + 0.5, 0.5 - asin(clamp(d.y, -1.0, 1.0)) / PI);
      vec3 a = textureLod(truth, uv, 0.0).rgb, b = textureLod(render, uv, 0.0).rgb;
      vec3 rgb = mode == 1 ? a : mode == 2 ? b : mode == 3 ? 4.0 * abs(a - b)
        : gl_FragCoord.x < divide * size.x ? b : a;
      if (covered && mode == 3 && textureLod(cover, uv, 0.0).a > 0.5) rgb = vec3(0.0);
      colour = vec4(rgb, 1.0);
    }`;
  const MODES = { compare: 0, truth: 1, render: 2, difference: 3 };

  // One WebGL context for the whole page: browsers allow only a few.
  let shared;
  function context() {
    if (shared !== undefined) return shared;
    const canvas = document.createElement("canvas");
    const gl = canvas.getContext("webgl2", { preserveDrawingBuffer: true });
    if (!gl) return (shared = null);
    const program = gl.createProgram();
    [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]].forEach(([kind, source]) => {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    });
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return (shared = null);
    gl.useProgram(program);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 3, -1, -1, 3]), gl.STATIC_DRAW);
    gl.bindAttribLocation(program, 0, "p");
    const place = gl.getAttribLocation(program, "p");
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, 2, gl.FLOAT, false, 0, 0);
    const at = name => gl.getUniformLocation(program, name);
    const textures = ["truth", "render", "cover"].map((name, unit) => {
      const texture = gl.createTexture();
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.REPEAT);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
      gl.uniform1i(at(name), unit);
      return null;
    });
    const loaded = textures;
    return (shared = {
      draw(truth, render, target, view, cover = null) {
        [truth, render, cover].forEach((image, unit) => {
          if (!image || loaded[unit] === image) return;
          gl.activeTexture(gl.TEXTURE0 + unit);
          gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
          loaded[unit] = image;
        });
        if (canvas.width !== target.width || canvas.height !== target.height) {
          canvas.width = target.width;
          canvas.height = target.height;
        }
        gl.viewport(0, 0, canvas.width, canvas.height);
        gl.uniform2f(at("size"), canvas.width, canvas.height);
        gl.uniform1f(at("yaw"), view.yaw);
        gl.uniform1f(at("pitch"), view.pitch);
        gl.uniform1f(at("spread"), view.spread);
        gl.uniform1f(at("divide"), view.divide);
        gl.uniform1i(at("mode"), MODES[view.mode]);
        gl.uniform1i(at("covered"), cover ? 1 : 0);
        gl.drawArrays(gl.TRIANGLES, 0, 3);
        target.getContext("2d").drawImage(canvas, 0, 0);
      },
    });
  }

  function viewer(figure) {
    const data = PB.data.viewers[figure.dataset.viewer];
    const stage = figure.querySelector(".stage"), canvas = figure.querySelector("canvas.look");
    const wipe = figure.querySelector(".wipe"), handle = figure.querySelector(".handle");
    const images = { truth: figure.querySelector("img.truth"), render: figure.querySelector("img.render") };
    const cover = figure.querySelector("img.cover"), tint = figure.querySelector("img.tint");
    const caption = figure.querySelector("figcaption");
    const state = { mode: "compare", view: "flat", run: data.start, frame: 0, yaw: 0, pitch: 0, spread: 1.75, ready: false };

    function repaint() {
      const looking = state.view === "look", compare = state.mode === "compare", share = Number(wipe.value) / 100;
      stage.dataset.mode = state.mode;
      stage.dataset.view = state.view;
      stage.style.setProperty("--share", `${100 * share}%`);
      canvas.hidden = !looking;
      wipe.hidden = !compare;
      cover.hidden = !(state.mode === "difference" && cover.dataset.key);
      tint.hidden = !(tint.dataset.key && !looking && (compare || state.mode === "truth"));
      if (!state.ready) return;
      if (looking && stage.clientWidth && stage.clientHeight && context()) {
        const ratio = Math.min(devicePixelRatio || 1, 2);
        canvas.width = Math.round(stage.clientWidth * ratio);
        canvas.height = Math.round(stage.clientHeight * ratio);
        context().draw(images.truth, images.render, canvas, { ...state, divide: share }, cover.dataset.key ? cover : null);
      }
    }
    function paintViews() {
      const gl = context();
      const views = figure.querySelector(".views");
      if (!views) return;
      if (!gl) { views.hidden = true; return; }
      PB.all("canvas", views).forEach(c => gl.draw(images.truth, images.render, c, {
        yaw: Number(c.dataset.yaw) * Math.PI / 180, pitch: 0, spread: 2 * Math.PI / 3, divide: 0, mode: c.dataset.kind }));
      figure.dataset.painted = "yes";
    }
    async function load() {
      const run = data.runs[state.run], frame = data.frames[state.frame];
      const pair = run.images[frame];
      state.ready = false;
      stage.style.aspectRatio = `${run.width} / ${run.height}`;
      figure.classList.toggle("no-panorama", !run.panorama);
      if (!run.panorama && state.view === "look") setView("flat");
      stage.dataset.missing = pair ? "no" : "yes";
      if (!pair) { caption.textContent = `${run.label} has no picture of frame ${frame}.`; return; }
      const [render, truth] = pair;
      figure.classList.toggle("no-truth", !truth);
      if (!truth && state.mode !== "render") setMode("render");
      images.render.src = PB.data.images[render];
      images.truth.src = PB.data.images[truth || render];
      cover.dataset.key = run.mask || "";
      if (run.mask) cover.src = PB.data.images[run.mask];
      tint.dataset.key = run.tints[frame] || "";
      if (tint.dataset.key) tint.src = PB.data.images[tint.dataset.key];
      images.render.alt = `Render of frame ${frame} by ${run.label}`;
      images.truth.alt = truth ? `Input frame ${frame}` : "";
      caption.textContent = `${run.label}, frame ${frame}. `;
      [[render, "render"], [truth, "input frame"]].forEach(([key, name]) => {
        if (!key || !PB.data.links[key]) return;
        const link = document.createElement("a");
        link.href = PB.data.links[key];
        link.textContent = `Full-size ${name}`;
        caption.append(link, " ");
      });
      await Promise.all([images.render.decode(), images.truth.decode(), ...(run.mask ? [cover.decode()] : [])]).catch(() => {});
      state.ready = images.render.naturalWidth > 0;
      repaint();
      if (state.ready && run.panorama) paintViews();
    }
    function setView(view) {
      state.view = view;
      PB.press(figure.querySelector("[data-view]").parentNode, figure.querySelector(`button[data-view="${view}"]`));
      repaint();
    }
    function setMode(mode) {
      state.mode = mode;
      PB.press(figure.querySelector("[data-mode]").parentNode, figure.querySelector(`[data-mode="${mode}"]`));
      repaint();
    }
    figure.querySelector(".bar").addEventListener("click", event => {
      const button = event.target.closest("button");
      if (!button) return;
      if (button.dataset.mode) setMode(button.dataset.mode);
      else setView(button.dataset.view);
    });
    figure.addEventListener("input", event => {
      const pick = event.target.dataset.pick;
      if (event.target === wipe) repaint();
      else if (pick) {
        state[pick] = Number(event.target.value);
        if (pick === "frame") event.target.closest("label").querySelector("output").textContent = data.frames[state.frame];
        load();
      }
    });
    let drag = null;
    stage.addEventListener("pointerdown", event => {
      if (event.button) return;
      const box = stage.getBoundingClientRect();
      const near = Math.abs(event.clientX - box.left - box.width * wipe.value / 100) < 28;
      if (state.mode === "compare" && (state.view === "flat" || near)) drag = "wipe";
      else if (state.view === "look") drag = "look";
      else return;
      stage.setPointerCapture(event.pointerId);
      event.preventDefault();
      (drag === "wipe" ? wipe : canvas).focus({ preventScroll: true });
      if (drag === "wipe") move(event);
    });
    function move(event) {
      const box = stage.getBoundingClientRect();
      if (drag === "wipe") wipe.value = 100 * (event.clientX - box.left) / box.width;
      else if (drag === "look") {
        const scale = 2 * Math.tan(state.spread / 2) / box.width;
        state.yaw -= event.movementX * scale;
        state.pitch = Math.max(-1.55, Math.min(1.55, state.pitch + event.movementY * scale));
      } else return;
      repaint();
    }
    stage.addEventListener("pointermove", move);
    ["pointerup", "pointercancel"].forEach(name => stage.addEventListener(name, () => { drag = null; }));
    canvas.addEventListener("keydown", event => {
      const step = 0.12;
      const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
      if (moves[event.key]) {
        state.yaw += moves[event.key][0];
        state.pitch = Math.max(-1.55, Math.min(1.55, state.pitch + moves[event.key][1]));
      } else if (event.key === "+" || event.key === "=") state.spread = Math.max(0.4, state.spread * 0.9);
      else if (event.key === "-") state.spread = Math.min(2.4, state.spread / 0.9);
      else return;
      event.preventDefault();
      repaint();
    });
    new ResizeObserver(repaint).observe(stage);
    handle.hidden = false;
    return load();
  }
  function start() {
    const watch = new IntersectionObserver(entries => entries.forEach(entry => {
      if (!entry.isIntersecting) return;
      watch.unobserve(entry.target);
      viewer(entry.target);
      entry.target.dataset.started = "yes";
    }), { rootMargin: "800px" });
    PB.all(".pano").forEach(figure => watch.observe(figure));
    PB.all("img[data-image]").forEach(image => { image.src = PB.data.images[image.dataset.image]; });
    addEventListener("beforeprint", () => PB.all(".pano:not([data-started])").forEach(f => { f.dataset.started = "yes"; watch.unobserve(f); viewer(f); }));
  }
  return { start };
})();
