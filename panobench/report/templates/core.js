const PB = {
  data: JSON.parse(document.getElementById("report-data").textContent),
  all(selector, root) { return Array.from((root || document).querySelectorAll(selector)); },
  css(name) { return getComputedStyle(document.documentElement).getPropertyValue(name).trim(); },
  colour(index) {
    if (index < 0) return PB.css("--truth");
    const palette = PB.css("--palette").split(/\s+/);
    return palette[index % palette.length];
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
    PB.all("[data-colour] > .swatch").forEach(s => { s.style.background = PB.colour(Number(s.parentNode.dataset.colour)); });
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
