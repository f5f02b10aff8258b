// The vehicle: an artificial horizon with a compass, and its track from above.

import { draw } from "./dom";
import { short } from "./numbers";
import { palette } from "./theme";
import type { Course, Recent } from "./series";

const DEGREES = 180 / Math.PI;
const PITCH = 1.6; // units of the drawing per degree

function horizon(): SVGSVGElement {
  const steps = [-40, -30, -20, -10, 10, 20, 30, 40].flatMap((at) => [
    draw("line", { class: "step", x1: -18, x2: 18, y1: -at * PITCH, y2: -at * PITCH }),
    draw("text", { x: 24, y: -at * PITCH + 4 }, String(Math.abs(at))),
  ]);
  const points = ["N", "E", "S", "W"].map((name, k) =>
    draw("text", { class: "point", transform: `rotate(${90 * k}) translate(0,-81)`, "text-anchor": "middle" }, name));
  const tilt = draw(
    "g", { id: "tilt" },
    draw("rect", { class: "sky", x: -200, y: -300, width: 400, height: 300 }),
    draw("rect", { class: "sea", x: -200, y: 0, width: 400, height: 300 }),
    draw("line", { class: "rim", x1: -200, x2: 200, y1: 0, y2: 0 }),
    ...steps,
  );
  return draw(
    "svg", { viewBox: "-100 -100 200 200", role: "img", "aria-label": "attitude not known yet" },
    draw("defs", {}, draw("clipPath", { id: "disc" }, draw("circle", { r: 74 }))),
    draw("g", { "clip-path": "url(#disc)" }, tilt),
    draw("circle", { class: "ring", r: 74 }),
    draw("g", { id: "compass" }, ...points),
    draw("path", { class: "craft", d: "M-46 0h28l8 9M46 0h-28l-8 9M0-3v6" }),
    draw("path", { class: "index", d: "M0-73l-6 12h12z" }),
  );
}

export class Horizon {
  private readonly svg: SVGSVGElement;
  private readonly tilt: SVGGElement;
  private readonly craft: SVGPathElement;
  private readonly compass: SVGGElement;
  private readonly words: HTMLElement;
  private told = 0;

  constructor(private readonly figure: HTMLElement) {
    this.svg = figure.appendChild(horizon());
    this.words = figure.appendChild(document.createElement("p"));
    this.words.className = "value";
    this.words.id = "attitude";
    this.tilt = figure.querySelector("#tilt")!;
    this.craft = figure.querySelector(".craft")!;
    this.compass = figure.querySelector("#compass")!;
    this.words.textContent = "not measured yet";
  }

  /** Draw what is known of roll, pitch and heading [rad]; of a heading alone the compass. */
  draw(phi: number, theta: number, psi: number): boolean {
    const [tilted, turned] = [!Number.isNaN(phi + theta), !Number.isNaN(psi)];
    if (!tilted && !turned) return false;
    this.figure.hidden = false;
    const [roll, pitch, heading] = [phi * DEGREES, theta * DEGREES, (((psi * DEGREES) % 360) + 360) % 360];
    for (const each of [this.tilt, this.craft]) each.style.display = tilted ? "" : "none";
    if (tilted) this.tilt.setAttribute("transform", `rotate(${-roll}) translate(0 ${pitch * PITCH})`);
    this.compass.style.display = turned ? "" : "none";
    if (turned) this.compass.setAttribute("transform", `rotate(${-heading})`);
    if (performance.now() - this.told > 250) {
      this.told = performance.now();
      const around = `roll ${short(Math.round(10 * (((roll + 540) % 360) - 180)) / 10, 3)}°, pitch ${short(Math.round(10 * pitch) / 10, 3)}°`;
      const ahead = `heading ${(Math.round(heading) % 360).toFixed(0)}°`;
      const text = tilted ? (turned ? `${around}, ${ahead}` : around) : `${ahead}; roll and pitch are not measured`;
      this.words.textContent = text;
      this.svg.setAttribute("aria-label", text);
    }
    return true;
  }
}

export class Track {
  private readonly canvas = document.createElement("canvas");
  private readonly words = document.createElement("p");
  private seen = false;

  constructor(private readonly figure: HTMLElement) {
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "track from above: position not measured yet");
    this.words.className = "value";
    this.words.textContent = "not measured yet";
    figure.append(this.canvas, this.words);
    new IntersectionObserver((entries) => {
      this.seen = entries[entries.length - 1].isIntersecting;
    }).observe(this.canvas);
  }

  draw(course: Course, recent: Recent, psi: number): boolean {
    if (!this.seen && !this.figure.hidden) return false;
    const [norths, easts] = [[...course.columns[0]], [...course.columns[1]]];
    for (const k of recent.rows(20, 200)) {
      const [x, y] = [recent.columns[0][k], recent.columns[1][k]];
      if (x === x && y === y && recent.t[k] > (course.t[course.t.length - 1] ?? -Infinity) - 0.5) {
        norths.push(x);
        easts.push(y);
      }
    }
    if (!norths.length) return false;
    this.figure.hidden = false;
    this.paint(norths, easts, psi);
    const text = `north ${norths[norths.length - 1].toFixed(2)} m, east ${easts[easts.length - 1].toFixed(2)} m`;
    if (this.words.textContent !== text) {
      this.words.textContent = text;
      this.canvas.setAttribute("aria-label", `track from above; now ${text}`);
    }
    return true;
  }

  private paint(norths: number[], easts: number[], psi: number): void {
    const ratio = devicePixelRatio;
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    const context = this.canvas.getContext("2d")!;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const [left, top, right, bottom] = [44, 8, width - 8, height - 34];
    const [n0, n1] = extent(norths);
    const [e0, e1] = extent(easts);
    const scale = Math.min((right - left) / (e1 - e0), (bottom - top) / (n1 - n0));
    const px = (east: number) => (left + right) / 2 + (east - (e0 + e1) / 2) * scale;
    const py = (north: number) => (top + bottom) / 2 - (north - (n0 + n1) / 2) * scale;
    const colours = palette();
    context.font = "12px system-ui, sans-serif";
    context.fillStyle = colours.ink;
    context.strokeStyle = colours.grid;
    context.lineWidth = 1;
    const step = nice(60 / scale);
    const places = step < 1 ? Math.ceil(-Math.log10(step)) : 0;
    context.textAlign = "center";
    for (let e = Math.ceil((e0 + e1) / 2 / step - (right - left) / 2 / scale / step) * step; px(e) <= right; e += step) {
      line(context, px(e), top, px(e), bottom);
      context.fillText(e.toFixed(places), px(e), bottom + 14);
    }
    context.textAlign = "right";
    for (let n = Math.ceil((n0 + n1) / 2 / step - (bottom - top) / 2 / scale / step) * step; py(n) >= top; n += step) {
      line(context, left, py(n), right, py(n));
      context.fillText(n.toFixed(places), left - 5, py(n) + 4);
    }
    context.textAlign = "center";
    context.fillText("east, m", (left + right) / 2, height - 4);
    context.save();
    context.translate(11, (top + bottom) / 2);
    context.rotate(-Math.PI / 2);
    context.fillText("north, m", 0, 0);
    context.restore();
    context.strokeStyle = colours.lines[0];
    context.lineWidth = 2;
    context.lineJoin = "round";
    context.beginPath();
    norths.forEach((north, k) => context.lineTo(px(easts[k]), py(north)));
    context.stroke();
    context.translate(px(easts[easts.length - 1]), py(norths[norths.length - 1]));
    context.rotate(Number.isNaN(psi) ? 0 : psi);
    context.fillStyle = colours.lines[1];
    context.strokeStyle = colours.paper;
    context.beginPath();
    context.moveTo(0, -12);
    context.lineTo(7, 9);
    context.lineTo(0, 5);
    context.lineTo(-7, 9);
    context.closePath();
    context.fill();
    context.stroke();
  }
}

function extent(values: number[]): [number, number] {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) {
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  const room = Math.max(0.1 * (high - low), 0.25);
  return [low - room, high + room];
}

function nice(least: number): number {
  const power = 10 ** Math.floor(Math.log10(least));
  return power * ([1, 2, 5, 10].find((factor) => factor * power >= least) ?? 10);
}

function line(context: CanvasRenderingContext2D, x0: number, y0: number, x1: number, y1: number): void {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}
