PB.plots = (() => {
  const PRINT = { width: 318, height: 240, autosize: false }; // half the width of an A4 page
  const FIELDS = ["contour", "heatmap", "surface"];
  let loading = null;
  const drawn = new Set();
  const hiddenRuns = new Map();

  async function unpack() {
    const text = document.getElementById("plotly-packed").textContent;
    const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.appendChild(script);
    return window.Plotly;
  }
  const library = () => (loading = loading || unpack());

  function axisStyle(axis) {
    const line = PB.css("--line");
    return { gridcolor: line, zerolinecolor: line, linecolor: line, automargin: true, exponentformat: "power", minexponent: 5, separatethousands: true, ...axis,
      title: { ...(axis || {}).title, font: { size: 12, color: PB.css("--muted") }, standoff: 8 } };
  }
  function sceneAxis(axis) {
    return { gridcolor: PB.css("--line"), zerolinecolor: PB.css("--line"), showbackground: false, showspikes: false,
      nticks: 5, ...axis, title: { ...axis.title, font: { size: 12, color: PB.css("--muted") } } };
  }
  // Repeats of a method share its colour; the second and later ones are dashed, as are colours used twice.
  function dashOf(trace, figure, div) {
    const place = div.closest("[data-place]");
    const button = place && place.querySelector(`.legend [data-run="${trace.meta.run}"][data-colour]`);
    const same = figure.data.filter(t => t.line && t.meta.colour === trace.meta.colour).indexOf(trace);
    const round = Math.floor(trace.meta.colour / PB.css("--palette").split(/\s+/).length);
    return ["solid", "dash", "dashdot", "longdash", "dot"][(button ? PB.turn(button) : Math.max(same, round)) % 5];
  }
  function styled(div, figure) {
    const hidden = hiddenRuns.get(div.closest("[data-place]")) || new Set();
    const data = figure.data.map(trace => {
      const colour = PB.colour(trace.meta.colour), truth = trace.meta.colour === -1;
      const copy = { ...trace, name: PB.plain(trace.name), visible: !hidden.has(trace.meta.run) };
      ["x", "y", "text"].forEach(k => {
        if (Array.isArray(trace[k])) copy[k] = trace[k].map(v => typeof v === "string" ? PB.plain(v) : v);
      });
      if (FIELDS.includes(trace.type)) return copy; // these have colours of their own
      if (trace.line) copy.line = { dash: truth ? "dot" : dashOf(trace, figure, div), color: colour, ...trace.line };
      if ((trace.marker && trace.meta.run !== -3) || trace.type === "bar") copy.marker = { color: colour, ...trace.marker };
      return copy;
    });
    const layout = {
      margin: { l: 8, r: 12, t: 8, b: 8 }, showlegend: false, hovermode: "closest",
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: PB.css("--font"), size: 12, color: PB.css("--ink") },
      hoverlabel: { bgcolor: PB.css("--surface"), bordercolor: PB.css("--line"), font: { color: PB.css("--ink"), family: PB.css("--font") } },
      legend: { orientation: "h", y: -0.25 },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: PB.css("--muted"), activecolor: PB.css("--accent") },
      ...figure.layout,
    };
    if (figure.layout.scene) {
      const s = figure.layout.scene;
      layout.scene = { ...s, xaxis: sceneAxis(s.xaxis), yaxis: sceneAxis(s.yaxis), zaxis: sceneAxis(s.zaxis) };
      layout.margin = { l: 0, r: 0, t: 0, b: 0 };
      const far = div.clientWidth < 500 ? 1.3 : 1; // narrow screens need more distance
      const eye = s.camera.eye;
      layout.scene.camera = { ...s.camera, eye: { x: far * eye.x, y: far * eye.y, z: far * eye.z } };
      if (div._fullLayout && div._fullLayout.scene) layout.scene.camera = div._fullLayout.scene.camera;
    } else {
      layout.xaxis = axisStyle(figure.layout.xaxis);
      layout.yaxis = axisStyle(figure.layout.yaxis);
      layout.dragmode = matchMedia("(pointer: coarse)").matches ? false : "zoom";
    }
    return { data, layout };
  }
  async function draw(div, size) {
    if (!window.Plotly) await library();
    const { data, layout } = styled(div, PB.data.figures[div.dataset.figure]);
    const spatial = Boolean(layout.scene);
    Object.assign(layout, size || { autosize: true });
    drawn.add(div);
    await Plotly.react(div, data, layout, { displaylogo: false, responsive: true, scrollZoom: false,
      displayModeBar: spatial ? "hover" : false,
      modeBarButtons: [["zoom3d", "pan3d", "orbitRotation", "resetCameraDefault3d", "toImage"]] });
    div.dataset.drawn = "yes";
  }
  function toggle(place, button) {
    const show = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(show));
    const hidden = hiddenRuns.get(place) || new Set();
    hiddenRuns.set(place, hidden);
    const run = Number(button.dataset.run);
    if (show) hidden.delete(run); else hidden.add(run);
    drawn.forEach(div => { if (place.contains(div)) draw(div); });
  }
  function start() {
    const watch = new IntersectionObserver(entries => entries.forEach(entry => {
      if (!entry.isIntersecting) return;
      watch.unobserve(entry.target);
      draw(entry.target);
    }), { rootMargin: "600px" });
    PB.all(".plot").forEach(div => watch.observe(div));
    PB.all("[data-place]").forEach(place => {
      const legend = place.querySelector(".legend");
      if (legend) legend.addEventListener("click", event => {
        const button = event.target.closest("button");
        if (button) toggle(place, button);
      });
    });
    PB.themeListeners.push(() => drawn.forEach(div => draw(div)));
    // Printing shows all sequences at once; the library is unpacked early so that drawing then needs no waiting.
    let closed = [];
    addEventListener("beforeprint", () => {
      closed = PB.all(".place.off");
      closed.forEach(place => place.classList.remove("off"));
      const flat = PB.all(".plot").filter(div => !div.closest(".spatial"));
      if (window.Plotly) flat.forEach(div => draw(div, PRINT));
    });
    addEventListener("afterprint", () => {
      closed.forEach(place => place.classList.add("off"));
      drawn.forEach(div => draw(div));
    });
    if (PB.all(".plot").length) (window.requestIdleCallback || setTimeout)(library);
  }
  return { start, draw, drawn };
})();
