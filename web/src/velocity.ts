// Velocities as measured and as the model predicts them, axis by axis; and all other signals.

import { Chart } from "./chart";
import { byId, write } from "./dom";
import { short } from "./numbers";
import type { Frame, Hello, State } from "./protocol";
import type { Recent } from "./series";

const SECONDS = 20;
const POINTS = 400;
const DEGREES = 180 / Math.PI;
const TITLES: Record<string, string> = {
  position: "Position", attitude: "Attitude", velocity: "Velocity", rates: "Turn rates", acceleration: "Specific force",
  force: "Force asked for", moment: "Moment asked for", commands: "Commands", voltage: "Supply",
};
const LEAST: Record<string, number> = { position: 0.2, attitude: 4, velocity: 0.1, rates: 4, acceleration: 0.5, force: 2, moment: 0.2, voltage: 0.5 };
const SYMBOLS: Record<string, string> = { phi: "roll φ", theta: "pitch θ", psi: "heading ψ" };

const unitOf = (k: number) => (k < 3 ? "m/s" : "°/s");
const scaleOf = (k: number) => (k < 3 ? 1 : DEGREES);

export class Velocities {
  private charts: Chart[] = [];
  private names: string[] = [];
  private found: boolean[] = [];
  private about = "";

  greet(hello: Hello): void {
    for (const chart of this.charts) chart.remove();
    this.about = `Free run of the model as learned now: started ${hello.prediction_seconds} s ago from the measured state, driven by the commands alone. Rms: of the difference.`;
    this.names = hello.axes.map((axis) => axis.velocity);
    this.found = hello.axes.map(() => false);
    const place = document.querySelector("#velocity .charts")!;
    this.charts = hello.axes.map((axis, k) => new Chart(place, {
      title: axis.name, x: "time, s", y: `${axis.velocity}, ${unitOf(k)}`, least: k < 3 ? 0.1 : 4, legend: byId("velocity-legend"),
      lines: [{ name: "measured", colour: 5, dash: 0, width: 2.25 }, { name: "predicted", colour: 1, dash: 1, width: 2.25 }],
    }));
    for (const chart of this.charts) chart.figure.hidden = true;
    byId("velocity-legend").hidden = true;
    write(byId("velocity-note"), "Neither velocity nor pose has been measured yet.");
  }

  /** Say how far off the prediction is; `stale`: why nothing can be said of now, else "". */
  show(state: State, stale: string): void {
    const rms = state.prediction?.rms;
    this.charts.forEach((chart, k) => {
      const off = stale ? null : rms?.[k];
      const text = off == null ? "" : `rms ${short(off * scaleOf(k), 2)} ${unitOf(k)}`;
      chart.say(stale || text);
      chart.describe(`${chart.settings.title}, measured and predicted; ${stale || (text ? `difference ${text}` : "nothing to compare yet")}`);
    });
    if (this.found.some(Boolean)) write(byId("velocity-note"), stale ? `Prediction: ${stale}. What is drawn is as of then.` : this.about + this.slopes(state));
  }

  draw(frame: Frame): void {
    const t = Array.from(frame.t);
    const n = this.charts.length;
    this.charts.forEach((chart, k) => {
      this.found[k] ||= frame.columns[k].some((value) => value === value);
      chart.figure.hidden = !this.found[k];
      const scale = scaleOf(k);
      if (this.found[k]) chart.set([t, numbers(frame.columns[k], scale), numbers(frame.columns[n + k], scale)]);
    });
    byId("velocity-legend").hidden = !this.found.some(Boolean);
  }

  /** Which velocities no sensor shows: they are slopes of what one does show. */
  private slopes(state: State): string {
    const derived = this.names.filter((name) => state.prediction?.derived.includes(name));
    if (!derived.length) return "";
    return ` Measured ${derived.join(", ")}: slope of the ${derived.join() === "r" ? "heading" : "pose"} over 0.4 s.`;
  }
}

function numbers(column: Float32Array, scale: number): (number | undefined)[] {
  return Array.from(column, (value) => (value === value ? value * scale : undefined));
}

interface Group { name: string; place: HTMLElement; columns: number[]; shown: number[]; chart: Chart | null }

/** A chart for each kind of signal, with a line for each one that has been measured at all. */
export class Signals {
  private groups: Group[] = [];
  private hello: Hello | null = null;

  greet(hello: Hello): void {
    for (const group of this.groups) {
      group.chart?.remove();
      group.place.remove();
    }
    this.hello = hello;
    const all = document.querySelector("#signals .charts")!;
    const columns = new Map<string, number[]>();
    hello.signals.forEach((signal, k) => columns.set(signal.chart, [...(columns.get(signal.chart) ?? []), k]));
    this.groups = [...columns].map(([name, own]) => {
      const place = all.appendChild(document.createElement("div"));
      place.className = "place";
      return { name, place, columns: own, shown: [], chart: null };
    });
  }

  draw(recent: Recent): void {
    const rows = recent.rows(SECONDS, POINTS);
    if (!rows.length || !this.hello) return;
    const t = rows.map((k) => recent.t[k]);
    for (const group of this.groups) {
      const shown = group.columns.filter((k) =>
        group.shown.includes(k) || rows.some((row) => recent.columns[k][row] === recent.columns[k][row]));
      if (shown.length !== group.shown.length) this.make(group, shown);
      if (!group.chart?.visible) continue;
      const { scale } = this.hello.signals[group.columns[0]];
      const columns = group.shown.map((k) => {
        const column = recent.columns[k];
        return rows.map((row) => (column[row] === column[row] ? column[row] * scale : undefined));
      });
      group.chart.set([t, ...columns]);
    }
  }

  private make(group: Group, shown: number[]): void {
    group.chart?.remove();
    group.shown = shown;
    const signals = this.hello!.signals;
    group.chart = new Chart(group.place, {
      title: TITLES[group.name] ?? group.name, x: "time, s", y: signals[shown[0]].unit, step: group.name === "commands",
      least: LEAST[group.name],
      lines: shown.map((k) => {
        const j = group.columns.indexOf(k);
        const signal = signals[k].name;
        return { name: SYMBOLS[signal] ?? signal, colour: j % 8, dash: (j + Math.floor(j / 8)) % 8, width: 1.5 };
      }),
    });
  }
}
