// Coefficients: a table of where they are, and a small chart of how each came there.

import { Chart } from "./chart";
import { byId, fill, write } from "./dom";
import { measured, percent, short, unit } from "./numbers";
import type { Hello, State } from "./protocol";
import type { Course } from "./series";

const SURE = 1.96;

export class Coefficients {
  private charts: Chart[] = [];

  constructor(private readonly marks: () => number[]) {}

  greet(hello: Hello): void {
    for (const chart of this.charts) chart.remove();
    const word = hello.reference_word;
    write(byId("reference-word"), word[0].toUpperCase() + word.slice(1));
    const known = hello.coefficients.some((each) => each.reference !== null);
    write(
      byId("convergence-note"),
      `Band: 95 % interval.${known ? ` Dashed: ${word === "truth" ? "the truth" : "the value before"}.` : ""} Upright dashes: events.`,
    );
    const place = document.querySelector("#convergence .charts")!;
    this.charts = hello.coefficients.map((each) => new Chart(place, {
      title: each.name, x: "time, s", y: unit(each.unit), band: true, marks: this.marks,
      lines: [{ name: "", colour: 0, dash: 0, width: 2 }, { name: "", colour: 1, dash: 1 }, { name: "" }, { name: "" }],
    }));
    for (const chart of this.charts) chart.figure.hidden = true; // until something is known
  }

  show(hello: Hello, state: State): void {
    const rows: string[][] = [];
    const unknown = new Map<string, string[]>();
    hello.coefficients.forEach((each, k) => {
      const found = state.coefficients[each.name];
      if (!found) return;
      const chart = this.charts[k];
      if (!found.identified || found.value === null) {
        const reason = found.reason ?? "not known yet";
        unknown.set(reason, [...(unknown.get(reason) ?? []), each.name]);
        rows.push([each.name, "not known", unit(each.unit), "–", short(each.reference, 5)]);
        chart.say("not known yet");
        return;
      }
      const [value, std] = measured(found.value, found.std);
      const text = std ? `${value} ± ${std}` : value;
      const relative = percent(found.relative_std);
      rows.push([each.name, text, unit(each.unit), relative, short(each.reference, 5)]);
      chart.figure.hidden = false;
      chart.say(text);
      chart.describe(`${each.name} is ${text} ${unit(each.unit)}, relative deviation ${relative}`);
    });
    const body = document.querySelector("#coefficients tbody")!;
    fill(body, rows, [1, 3, 4]);
    [...body.children].forEach((row, k) => row.setAttribute("data-name", rows[k][0]));
    const told = [...unknown].map(([reason, names]) => `${names.join(", ")}: ${reason}`);
    write(byId("unknown"), told.length ? `Not known: ${told.join("; ")}.` : "");
  }

  draw(hello: Hello, course: Course): void {
    const n = hello.coefficients.length;
    this.charts.forEach((chart, k) => {
      if (!chart.visible) return;
      const values = course.columns[k];
      const std = course.columns[n + k];
      const low: (number | null)[] = [];
      const high: (number | null)[] = [];
      const middle: (number | null)[] = [];
      for (let i = 0; i < course.t.length; i++) {
        const known = values[i] === values[i];
        middle.push(known ? values[i] : null);
        low.push(known ? values[i] - SURE * std[i] : null);
        high.push(known ? values[i] + SURE * std[i] : null);
      }
      const { reference, earlier } = hello.coefficients[k];
      const since = hello.reference_since ?? -Infinity;
      const t = [...course.t]; // the course itself grows before the chart is drawn again
      chart.settings.range = () => spread(t, middle, low, high, reference);
      chart.set([t, middle, t.map((at) => (at < since ? earlier : reference)), low, high]);
    });
  }
}

/** What to show: everything of the later half, and of the earlier one what is not far off it. */
function spread(
  t: number[], middle: (number | null)[], low: (number | null)[], high: (number | null)[], reference: number | null,
): [number, number] {
  const half = t.length ? (t[0] + t[t.length - 1]) / 2 : 0;
  let [least, most] = reference === null ? [Infinity, -Infinity] : [reference, reference];
  for (let k = 0; k < t.length; k++) {
    if (t[k] < half || middle[k] === null) continue;
    least = Math.min(least, low[k]!);
    most = Math.max(most, high[k]!);
  }
  const last = middle[middle.length - 1];
  if (!(least < Infinity)) return last == null ? [-1, 1] : [last - 1, last + 1];
  const room = Math.max(most - least, 0.02 * Math.abs(most)) * 0.25;
  return [least - room, most + room];
}
