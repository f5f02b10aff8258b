// Elements that lie over each other, or stick out of the window.
() => {
  const wanted = "header > *, .controls > *, #verdict, main > section, figure, h2, table, dl > div, .note";
  const shown = [...document.querySelectorAll(wanted)].filter(
    (e) => e.offsetParent !== null && !e.classList.contains("hidden") && e.getBoundingClientRect().width > 1,
  );
  const box = (e) => { // what a scrolling parent cuts off is not seen
    const own = e.getBoundingClientRect();
    const frame = e.closest(".scroll")?.getBoundingClientRect() ?? own;
    return {
      left: Math.max(own.left, frame.left), top: Math.max(own.top, frame.top),
      right: Math.min(own.right, frame.right), bottom: Math.min(own.bottom, frame.bottom),
    };
  };
  const name = (e) => e.id || e.className || e.textContent.slice(0, 20);
  const found = [];
  for (const [i, a] of shown.entries())
    for (const b of shown.slice(i + 1)) {
      if (a.contains(b) || b.contains(a)) continue;
      const [p, q] = [box(a), box(b)];
      const wide = Math.min(p.right, q.right) - Math.max(p.left, q.left);
      const high = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
      if (wide > 1 && high > 1) found.push([name(a), name(b), wide, high]);
    }
  const sticking = [...document.querySelectorAll("body *")]
    .filter((e) => e.offsetParent !== null && !e.closest(".scroll, .hidden, .skip, svg"))
    .filter((e) => e.getBoundingClientRect().right > innerWidth + 1)
    .map((e) => e.outerHTML.slice(0, 80));
  return { found, sticking, wide: document.documentElement.scrollWidth - innerWidth };
}
