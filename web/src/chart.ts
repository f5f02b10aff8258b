// One chart: uPlot in a figure, with its axes named, redrawn only where it can be seen.

import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { draw } from "./dom";
import { DASHES, onTheme, palette } from "./theme";

export interface Line { name: string; colour?: number; dash?: number; width?: number }

export interface Settings {
  title: string;
  x: string;
  y: string;
  lines: Line[];
  band?: boolean; // the last two lines are the edges of a band, and are not drawn themselves
  step?: boolean;
  range?: (low: number, high: number) => [number, number];
  least?: number; // of the height, so that noise does not fill it
  marks?: () => number[]; // times of events
  legend?: Element; // a place that several charts share
}

export const charts: Chart[] = [];
const FONT = "12px system-ui, sans-serif";

export class Chart {
  readonly figure = document.createElement("figure");
  private readonly caption = document.createElement("figcaption");
  private readonly value = document.createElement("span");
  private readonly place = document.createElement("div");
  private plot: uPlot | null = null;
  private data: uPlot.AlignedData = [[]];
  private seen = false;
  private stale = true;

  constructor(parent: Element, readonly settings: Settings) {
    this.figure.className = "chart";
    this.caption.append(settings.title);
    this.value.className = "value";
    this.caption.append(" ", this.value);
    this.place.setAttribute("role", "img");
    this.place.setAttribute("aria-label", `${settings.title}: ${settings.y} over ${settings.x}`);
    this.figure.append(this.caption, this.place);
    if (settings.legend) settings.legend.replaceChildren(this.legend());
    else if (settings.lines.some((line) => line.name)) this.figure.append(this.legend());
    parent.append(this.figure);
    new ResizeObserver(() => this.resize()).observe(this.place);
    new IntersectionObserver((entries) => {
      this.seen = entries[entries.length - 1].isIntersecting;
    }, { rootMargin: "150px" }).observe(this.place);
    onTheme(() => this.make());
    charts.push(this);
  }

  say(text: string): void {
    if (this.value.textContent !== text) this.value.textContent = text;
  }

  describe(text: string): void {
    this.place.setAttribute("aria-label", text);
  }

  set(data: uPlot.AlignedData): void {
    this.data = data;
    this.stale = true;
  }

  get visible(): boolean {
    return this.seen;
  }

  /** Draw where it is due; say whether anything was drawn. */
  draw(): boolean {
    if (!this.seen || !this.stale) return false;
    if (!this.plot) this.make();
    this.stale = false;
    this.plot?.setData(this.data);
    return this.plot !== null;
  }

  remove(): void {
    this.plot?.destroy();
    this.figure.remove();
    charts.splice(charts.indexOf(this), 1);
  }

  private resize(): void {
    const width = this.place.clientWidth;
    if (width && this.plot) this.plot.setSize({ width, height: this.place.clientHeight });
    this.stale = true;
  }

  private make(): void {
    if (!this.figure.isConnected) return;
    this.plot?.destroy();
    this.plot = null;
    const width = this.place.clientWidth;
    if (width) this.plot = new uPlot(this.options(width), this.data, this.place);
    this.recolour();
  }

  private options(width: number): uPlot.Options {
    const { x, y, lines, band, step, marks } = this.settings;
    const colours = palette();
    const axis = { stroke: colours.ink, font: FONT, labelFont: FONT, labelSize: 16, labelGap: 0, gap: 3 };
    const grid = { stroke: colours.grid, width: 1 };
    const paths = step ? uPlot.paths.stepped?.({ align: 1 }) : undefined;
    const hidden = band ? lines.length - 2 : lines.length;
    return {
      width,
      height: this.place.clientHeight || 130,
      padding: [6, 8, 0, 0],
      legend: { show: false },
      cursor: { show: false },
      scales: {
        x: { time: false },
        y: { range: (_, low, high) => this.within(this.settings.range?.(low, high) ?? [low, high]) },
      },
      axes: [
        { ...axis, grid, ticks: grid, size: 24, label: x, labelSize: 18, space: 40 },
        { ...axis, grid, ticks: grid, size: 52, label: y, space: 26, values: (_, at) => at.map((v) => tick(v, at)) },
      ],
      series: [
        {},
        ...lines.map((line, k): uPlot.Series => k < hidden
          ? {
              label: line.name, stroke: colours.lines[(line.colour ?? k) % colours.lines.length], width: line.width ?? 1.75,
              dash: DASHES[(line.dash ?? k) % DASHES.length], points: { show: false }, spanGaps: true, paths,
            }
          : { label: line.name, stroke: "transparent", width: 0, points: { show: false } }),
      ],
      bands: band ? [{ series: [lines.length, lines.length - 1], fill: colours.band }] : [],
      hooks: { draw: marks ? [(plot) => drawMarks(plot, marks(), palette().event)] : [] },
    };
  }

  private within([low, high]: [number, number]): [number, number] {
    if (!Number.isFinite(low) || !Number.isFinite(high)) return [-1, 1];
    const room = Math.max(0.08 * (high - low), ((this.settings.least ?? 0) - (high - low)) / 2, 1e-6 * Math.max(Math.abs(low), Math.abs(high)), 1e-6);
    return [low - room, high + room];
  }

  private legend(): HTMLElement {
    const list = document.createElement("ul");
    list.className = "legend";
    this.settings.lines.forEach((line, k) => {
      if (!line.name) return;
      const item = document.createElement("li");
      const stroke = draw("line", { x1: 0, y1: 4, x2: 26, y2: 4, "stroke-width": 2.5 });
      item.append(draw("svg", { width: 26, height: 8, "aria-hidden": "true" }, stroke));
      item.dataset.colour = String(line.colour ?? k);
      item.querySelector("line")!.setAttribute("stroke-dasharray", DASHES[(line.dash ?? k) % DASHES.length].join(" "));
      item.append(line.name);
      list.append(item);
    });
    return list;
  }

  private recolour(): void {
    const { lines } = palette();
    const place = this.settings.legend ?? this.figure;
    for (const item of place.querySelectorAll<HTMLElement>(".legend li"))
      item.querySelector("line")!.setAttribute("stroke", lines[Number(item.dataset.colour) % lines.length]);
  }
}

function tick(value: number, all: number[]): string {
  const step = all.length > 1 ? Math.abs(all[1] - all[0]) : Math.abs(value);
  if (Math.abs(value) >= 1e5) return value.toExponential(0);
  return value.toFixed(step && step < 1 ? Math.min(4, Math.ceil(-Math.log10(step) - 1e-9)) : 0);
}

function drawMarks(plot: uPlot, times: number[], colour: string): void {
  const { ctx, bbox } = plot;
  const { min, max } = plot.scales.x;
  if (min == null || max == null) return;
  ctx.save();
  ctx.strokeStyle = colour;
  ctx.lineWidth = 1.5 * devicePixelRatio;
  ctx.setLineDash([4 * devicePixelRatio, 3 * devicePixelRatio]);
  for (const t of times) {
    if (t < min || t > max) continue;
    const x = plot.valToPos(t, "x", true);
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
  }
  ctx.restore();
}
