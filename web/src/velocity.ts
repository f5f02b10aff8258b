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

  greet(hello: Hello): void {
    for (const chart of this.charts) chart.remove();
    write(
      byId("velocity-note"),
      `Free run of the model as learned now: started ${hello.prediction_seconds} s ago from the measured state, driven by the commands alone. The newest 0.2 s of a velocity taken from poses is not known yet.`,
    );
    const place = document.querySelector("#velocity .charts")!;
    this.charts = hello.axes.map((axis, k) => new Chart(place, {
      title: axis.name, x: "time, s", y: `${axis.velocity}, ${unitOf(k)}`, least: k < 3 ? 0.1 : 4, legend: byId("velocity-legend"),
      lines: [{ name: "measured", colour: 5, dash: 0, width: 2.25 }, { name: "predicted", colour: 1, dash: 1, width: 2.25 }],
    }));
  }

  show(state: State): void {
    const rms = state.prediction?.rms;
    this.charts.forEach((chart, k) => {
      const off = rms?.[k];
      const text = off == null ? "" : `off by ${short(off * scaleOf(k), 2)} ${unitOf(k)} rms`;
      chart.say(text);
      chart.describe(`${chart.settings.title}, measured and predicted; ${text || "nothing to compare yet"}`);
    });
  }

  draw(frame: Frame): void {
    const t = Array.from(frame.t);
    const n = this.charts.length;
    this.charts.forEach((chart, k) => {
      const scale = scaleOf(k);
      chart.set([t, numbers(frame.columns[k], scale), numbers(frame.columns[n + k], scale)]);
    });
  }
}

function numbers(column: Float32Array, scale: number): (number | undefined)[] {
  return Array.from(column, (value) => (value === value ? value * scale : undefined));
}

export class Signals {
  private charts = new Map<string, { chart: Chart; columns: number[]; scale: number; found: boolean }>();

  greet(hello: Hello): void {
    for (const { chart } of this.charts.values()) chart.remove();
    this.charts.clear();
    const place = document.querySelector("#signals .charts")!;
    const groups = new Map<string, number[]>();
    hello.signals.forEach((signal, k) => groups.set(signal.chart, [...(groups.get(signal.chart) ?? []), k]));
    for (const [name, columns] of groups) {
      const { unit, scale } = hello.signals[columns[0]];
      const chart = new Chart(place, {
        title: TITLES[name] ?? name, x: "time, s", y: unit, step: name === "commands", least: LEAST[name],
        lines: columns.map((k, j) => {
          const signal = hello.signals[k].name;
          return { name: SYMBOLS[signal] ?? signal, colour: j % 8, dash: (j + Math.floor(j / 8)) % 8, width: 1.5 };
        }),
      });
      chart.figure.hidden = true;
      this.charts.set(name, { chart, columns, scale, found: false });
    }
  }

  draw(recent: Recent): void {
    const rows = recent.rows(SECONDS, POINTS);
    if (!rows.length) return;
    const t = rows.map((k) => recent.t[k]);
    for (const entry of this.charts.values()) {
      if (!entry.found) {
        entry.found = entry.columns.some((k) => rows.some((row) => recent.columns[k][row] === recent.columns[k][row]));
        entry.chart.figure.hidden = !entry.found;
      }
      if (!entry.found || !entry.chart.visible) continue;
      const columns = entry.columns.map((k) => {
        const column = recent.columns[k];
        return rows.map((row) => (column[row] === column[row] ? column[row] * entry.scale : undefined));
      });
      entry.chart.set([t, ...columns]);
    }
  }
}
