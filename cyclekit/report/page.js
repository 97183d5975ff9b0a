"use strict";
// Optional: the page is complete without it. Shows the numbers under the pointer and filters rows.
(() => {
  const tip = document.createElement("div");
  tip.className = "tip-box";
  tip.setAttribute("aria-hidden", "true"); // the tables hold the same numbers
  tip.hidden = true;
  document.body.append(tip);

  for (const part of document.querySelectorAll("g.tip")) {
    const title = part.querySelector("title");
    if (title) {
      part.dataset.tip = title.textContent;
      title.remove();
    }
  }

  const show = (event) => {
    const part = event.target instanceof Element ? event.target.closest("g.tip") : null;
    if (!part) {
      tip.hidden = true;
      return;
    }
    tip.textContent = part.dataset.tip;
    tip.hidden = false;
    const room = document.documentElement.clientWidth - tip.offsetWidth - 8;
    tip.style.left = `${Math.max(8, Math.min(event.clientX + 14, room))}px`;
    tip.style.top = `${event.clientY > 90 ? event.clientY - tip.offsetHeight - 12 : event.clientY + 18}px`;
  };
  document.addEventListener("pointermove", show);
  document.addEventListener("pointerdown", show);
  document.addEventListener("scroll", () => { tip.hidden = true; }, { passive: true });

  for (const field of document.querySelectorAll(".filter")) {
    const section = field.closest("section");
    const input = field.querySelector("input");
    const count = field.querySelector("output");
    field.hidden = false;
    input.addEventListener("input", () => {
      const wanted = input.value.trim().toLowerCase();
      const has = (text) => text.toLowerCase().includes(wanted);
      for (const part of section.querySelectorAll("g.tip[data-row]")) {
        part.classList.toggle("out", !has(part.dataset.row));
      }
      const rows = [...section.querySelectorAll("tbody tr")];
      for (const row of rows) row.hidden = !has(row.cells[0].textContent);
      count.textContent = wanted ? `${rows.filter((row) => !row.hidden).length} / ${rows.length}` : "";
    });
  }
})();
