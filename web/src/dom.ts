// Small helpers: elements by id, texts that are written only where they change.

export function byId<T extends HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`no element ${id}`);
  return found as T;
}

/** Make an element of a drawing; the page never takes a text for HTML. */
export function draw<K extends keyof SVGElementTagNameMap>(
  name: K, attributes: Record<string, string | number> = {}, ...children: (Node | string)[]
): SVGElementTagNameMap[K] {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  made.append(...children);
  return made;
}

export function write(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** Make a table's body hold these rows; cells are rewritten only where they change. */
export function fill(body: Element, rows: string[][], numbers: number[] = [], heading = true): void {
  while (body.children.length > rows.length) body.lastElementChild!.remove();
  rows.forEach((cells, k) => {
    let row = body.children[k] as HTMLTableRowElement | undefined;
    if (!row || row.children.length !== cells.length) {
      const fresh = document.createElement("tr");
      cells.forEach((_, j) => {
        const cell = document.createElement(heading && j === 0 ? "th" : "td");
        if (cell.tagName === "TH") cell.setAttribute("scope", "row");
        if (numbers.includes(j)) cell.className = "number";
        fresh.append(cell);
      });
      if (row) row.replaceWith(fresh);
      else body.append(fresh);
      row = fresh;
    }
    cells.forEach((text, j) => write(row.children[j], text));
  });
}

export function list(parent: Element, texts: string[]): void {
  while (parent.children.length > texts.length) parent.lastElementChild!.remove();
  texts.forEach((text, k) => {
    const item = parent.children[k] ?? parent.appendChild(document.createElement("li"));
    write(item, text);
  });
}

/** Show where a box can be scrolled sideways: a shadow at that edge, and a line of words below. */
export function hintScroll(box: HTMLElement): void {
  const hint = document.createElement("p");
  hint.className = "hint";
  hint.setAttribute("aria-hidden", "true");
  hint.textContent = "↔ more columns: scroll sideways";
  hint.hidden = true;
  box.after(hint);
  const look = (): void => {
    const left = box.scrollLeft > 1;
    const right = box.scrollLeft + box.clientWidth < box.scrollWidth - 1;
    box.dataset.more = left && right ? "both" : left ? "left" : right ? "right" : "";
    hint.hidden = !left && !right;
  };
  box.addEventListener("scroll", look, { passive: true });
  const sizes = new ResizeObserver(look);
  sizes.observe(box);
  if (box.firstElementChild) sizes.observe(box.firstElementChild);
}
