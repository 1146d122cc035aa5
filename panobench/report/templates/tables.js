PB.tables = (() => {
  function value(row, column) {
    const cell = row.cells[column];
    if (cell.dataset.value !== undefined) return Number(cell.dataset.value);
    return cell.classList.contains("num") ? null : cell.textContent.trim().toLowerCase();
  }
  function sortable(table) {
    const body = table.tBodies[0];
    const original = Array.from(body.rows);
    Array.from(table.tHead.rows[0].cells).forEach((head, column) => {
      const inner = head.querySelector(".head");
      const button = document.createElement("button");
      button.type = "button";
      while (inner.firstChild) button.appendChild(inner.firstChild);
      inner.appendChild(button);
      button.addEventListener("click", () => {
        const first = head.dataset.better === "higher" ? "descending" : "ascending";
        const second = first === "ascending" ? "descending" : "ascending";
        const now = head.getAttribute("aria-sort");
        const next = now === first ? second : now === second ? null : first;
        PB.all("th[aria-sort]", table.tHead).forEach(h => h.removeAttribute("aria-sort"));
        if (next) head.setAttribute("aria-sort", next);
        const sign = next === "descending" ? -1 : 1;
        const rows = !next ? original : original.slice().sort((a, b) => {
          const x = value(a, column), y = value(b, column);
          if (x === null || y === null) return (x === null) - (y === null);
          return sign * (typeof x === "string" ? x.localeCompare(y, undefined, { numeric: true }) : x - y);
        });
        table.classList.toggle("sorted", Boolean(next));
        body.append(...rows);
      });
    });
  }
  function filterable(box) {
    const bar = box.querySelector(".filters");
    if (!bar) return;
    const rows = Array.from(box.querySelector("tbody").rows);
    const facets = rows.map(row => JSON.parse(row.dataset.facets));
    const count = bar.querySelector(".count");
    function apply() {
      const controls = PB.all("[data-filter]", bar);
      let shown = 0;
      rows.forEach((row, i) => {
        const keep = controls.every(control => {
          const name = control.dataset.filter;
          if (name === "published") return control.checked || !row.classList.contains("published");
          if (name === "text") return row.textContent.toLowerCase().includes(control.value.trim().toLowerCase());
          return !control.value || facets[i][name] === control.value;
        });
        row.hidden = !keep;
        shown += keep;
      });
      count.textContent = shown === rows.length ? `${rows.length} rows` : `${shown} of ${rows.length} rows`;
    }
    bar.hidden = false;
    bar.addEventListener("input", apply);
    apply();
  }
  // A table that goes on to the right fades out there.
  function edged(scroll) {
    const tell = () => {
      const more = scroll.scrollWidth - scroll.clientWidth - scroll.scrollLeft > 4;
      if (more) scroll.dataset.more = "right"; else delete scroll.dataset.more;
    };
    scroll.addEventListener("scroll", tell, { passive: true });
    new ResizeObserver(tell).observe(scroll);
  }
  return { start() {
    PB.all(".table").forEach(box => { sortable(box.querySelector("table")); filterable(box); });
    PB.all(".scroll").forEach(edged);
  } };
})();
