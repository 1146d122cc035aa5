PB.tabs = {
  start() {
    const list = document.querySelector("[role=tablist]");
    if (!list) return;
    const tabs = PB.all("[role=tab]", list);
    function select(tab, focus) {
      tabs.forEach(t => {
        const on = t === tab;
        t.setAttribute("aria-selected", String(on));
        t.tabIndex = on ? 0 : -1;
        document.getElementById(t.getAttribute("aria-controls")).classList.toggle("off", !on);
      });
      if (focus) tab.focus();
    }
    list.addEventListener("click", event => {
      const tab = event.target.closest("[role=tab]");
      if (tab) select(tab, false);
    });
    list.addEventListener("keydown", event => {
      const here = tabs.indexOf(document.activeElement);
      const next = { ArrowRight: here + 1, ArrowLeft: here - 1, Home: 0, End: tabs.length - 1 }[event.key];
      if (here < 0 || next === undefined) return;
      event.preventDefault();
      select(tabs[(next + tabs.length) % tabs.length], true);
    });
    select(tabs[0], false);
  },
};

PB.extras = {
  start() {
    function reveal() {
      const target = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1)));
      if (target && target.tagName === "DETAILS") target.open = true;
    }
    addEventListener("hashchange", reveal);
    reveal();
    PB.all("[data-copy]").forEach(button => {
      button.hidden = false;
      button.addEventListener("click", async () => {
        const pre = button.parentNode.querySelector("pre");
        try { await navigator.clipboard.writeText(pre.textContent); button.textContent = "Copied"; }
        catch { getSelection().selectAllChildren(pre); button.textContent = "Selected"; }
        setTimeout(() => { button.textContent = "Copy"; }, 1500);
      });
    });
    const find = document.querySelector("[data-runs]");
    if (find) {
      const runs = PB.all("#runs > .run"), count = find.querySelector(".count");
      const apply = () => {
        const words = find.querySelector("input").value.trim().toLowerCase().split(/\s+/);
        const shown = runs.filter(run => {
          const text = run.textContent.toLowerCase();
          run.hidden = !words.every(word => text.includes(word));
          return !run.hidden;
        }).length;
        count.textContent = shown === runs.length ? `${shown} runs` : `${shown} of ${runs.length} runs`;
      };
      find.hidden = false;
      find.addEventListener("input", apply);
      apply();
    }
    // Paper shows the commands of a few runs; configuration stays with the page and run.json.
    let closed = [];
    addEventListener("beforeprint", () => {
      const many = PB.all(".run").length > 4;
      closed = PB.all("details:not([open])").filter(d => !d.matches(".inner") && !(many && d.matches(".run")));
      closed.forEach(d => { d.open = true; });
    });
    addEventListener("afterprint", () => closed.forEach(d => { d.open = false; }));
  },
};

PB.tables.start();
PB.tabs.start();
PB.pano.start();
PB.plots.start();
PB.extras.start();
PB.theme.start();
