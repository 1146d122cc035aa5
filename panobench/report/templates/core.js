const PB = {
  data: JSON.parse(document.getElementById("report-data").textContent),
  all(selector, root) { return Array.from((root || document).querySelectorAll(selector)); },
  css(name) { return getComputedStyle(document.documentElement).getPropertyValue(name).trim(); },
  colour(index) {
    if (index < 0) return PB.css("--truth");
    const palette = PB.css("--palette").split(/\s+/);
    return palette[index % palette.length];
  },
  // Which line of its colour a legend's button stands for, 0 for the first: the others are dashed.
  turn(button) {
    const count = PB.css("--palette").split(/\s+/).length, colour = Number(button.dataset.colour);
    const same = PB.all("[data-colour]", button.parentNode).filter(b => {
      const other = Number(b.dataset.colour);
      return colour < 0 ? other === colour : other >= 0 && other % count === colour % count;
    });
    return same.indexOf(button);
  },
  swatch(button) {
    const colour = PB.colour(Number(button.dataset.colour)), turn = PB.turn(button);
    const [line, gap] = button.dataset.colour === "-1" ? [3, 3] : [[24, 0], [7, 3], [4, 4], [10, 4], [2, 3]][turn % 5];
    return `repeating-linear-gradient(90deg, ${colour} 0 ${line}px, transparent ${line}px ${line + gap}px)`;
  },
  // Plotly reads a few HTML tags in texts; names from data must stay plain.
  plain(text) { return String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;"); },
  press(group, button) {
    PB.all("button", group).forEach(b => b.setAttribute("aria-pressed", String(b === button)));
  },
  themeListeners: [],
};

PB.theme = (() => {
  const group = document.querySelector(".theme");
  const system = matchMedia("(prefers-color-scheme: dark)");
  const stored = () => { try { return localStorage.getItem("panobench-theme") || "auto"; } catch { return "auto"; } };
  function apply(choice) {
    const dark = choice === "dark" || (choice === "auto" && system.matches);
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    PB.press(group, group.querySelector(`[data-theme="${choice}"]`));
    PB.all("[data-colour] > .swatch").forEach(s => { s.style.background = PB.swatch(s.parentNode); });
    PB.all(".drawing [data-colour]").forEach(line => { line.style.stroke = PB.colour(Number(line.dataset.colour)); });
    PB.themeListeners.forEach(f => f());
  }
  let choice = stored();
  group.hidden = false;
  group.addEventListener("click", event => {
    const button = event.target.closest("button");
    if (!button) return;
    choice = button.dataset.theme;
    try { localStorage.setItem("panobench-theme", choice); } catch { /* private window */ }
    apply(choice);
  });
  system.addEventListener("change", () => apply(choice));
  return { start() { apply(["auto", "light", "dark"].includes(choice) ? choice : "auto"); }, apply };
})();
