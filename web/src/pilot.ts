// The pilot's mode: what to drive now and next, axis by axis, with a count-down that runs between two messages.

import { byId, draw, fill, write } from "./dom";
import { percent } from "./numbers";
import type { Movement, Plan } from "./protocol";

const WIDE = 100; // units of the drawing for a whole segment
const TALL = 18; // of one axis
const LEAD = 5; // s before the segment that are drawn
const DONE = 0.5; // share of a movement that counts as done

/** A time to the tenth of a second, never below nought. */
const tenths = (seconds: number): string => Math.max(seconds, 0).toFixed(1);

export class Pilot {
  private readonly place = byId("plan");
  private readonly begin = byId<HTMLButtonElement>("plan-begin");
  private readonly hold = byId<HTMLButtonElement>("plan-hold");
  private readonly table = this.place.querySelector("table")!;
  private readonly body = this.table.tBodies[0];
  private readonly line = byId("plan-line");
  private plan: Plan | null = null;
  private came = 0; // when the plan's clock was told, on the page's clock [ms]
  private drawn = ""; // what the line shows
  private cursor: SVGElement | null = null;

  constructor(ask: (what: string) => void) {
    this.begin.onclick = () => ask(this.plan?.stage === "held" ? "on" : "begin");
    this.hold.onclick = () => ask("hold");
  }

  show(plan: Plan | null, able: boolean): void {
    this.place.hidden = plan === null || (plan.stage === "think" && plan.movements.length === 0 && plan.planned === 0);
    this.plan = plan;
    this.came = performance.now();
    if (!plan) return;
    const { stage } = plan;
    this.place.dataset.stage = stage;
    write(byId("plan-text"), plan.text);
    write(this.begin, stage === "held" ? "Go on" : "Begin");
    write(this.hold, stage === "drive" ? "Break off" : "Hold");
    this.begin.disabled = !able || !(stage === "bring" || stage === "held");
    this.hold.disabled = !able || !(stage === "bring" || stage === "count" || stage === "drive");
    this.shares(plan);
    const many = plan.planned > plan.segment ? ` of about ${plan.planned}` : "";
    const met = plan.known.filter((each) => each.met).length;
    write(
      byId("plan-note"),
      `Segment ${plan.segment}${many}; ${plan.manoeuvred_s.toFixed(0)} s driven; ${met} of ${plan.known.length} coefficients known to ${percent(plan.accuracy)}. ` +
        "Percentages are of the full stick. Driving late or too weakly does no harm: what is really driven counts.",
    );
    this.paint(plan);
    this.draw();
  }

  /** Called with every picture: clocks go on between two messages. */
  draw(): void {
    const plan = this.plan;
    if (!plan || this.place.hidden) return;
    const clock = plan.clock_s === null ? null : plan.clock_s + (performance.now() - this.came) / 1000;
    if (plan.stage === "count" && clock !== null) write(byId("plan-text"), `Segment ${plan.segment} begins in ${Math.max(Math.ceil(-clock), 0)}.`);
    fill(this.body, plan.axes.map((axis) => this.row(plan, axis, clock)), [2, 4]);
    this.table.hidden = plan.axes.length === 0; // nothing is left to drive
    [...this.body.children].forEach((row, k) => {
      (row as HTMLElement).dataset.active = String(this.now(plan, plan.axes[k], clock) !== undefined);
    });
    if (this.cursor && clock !== null) {
      const x = (WIDE * Math.min(Math.max(clock + LEAD, 0), plan.duration_s + LEAD)) / (plan.duration_s + LEAD);
      this.cursor.setAttribute("x1", x.toFixed(2));
      this.cursor.setAttribute("x2", x.toFixed(2));
    }
    this.cursor?.setAttribute("visibility", clock === null ? "hidden" : "visible");
  }

  private now(plan: Plan, axis: string, clock: number | null): Movement | undefined {
    if (clock === null) return undefined;
    return plan.movements.find((each) => each.axis === axis && each.start_s <= clock && clock < each.end_s);
  }

  private row(plan: Plan, axis: string, clock: number | null): string[] {
    const own = plan.movements.filter((each) => each.axis === axis);
    const now = this.now(plan, axis, clock);
    const next = own.find((each) => clock === null || each.start_s > clock);
    const over = own.filter((each) => each.done !== null);
    const done = over.filter((each) => each.done! >= DONE).length;
    return [
      axis,
      now ? now.text : plan.stage === "drive" ? "let go" : "",
      now && clock !== null ? tenths(now.end_s - clock) : "",
      next ? next.text : "let go",
      next && clock !== null ? tenths(next.start_s - clock) : "",
      over.length ? `${done} of ${over.length}` : "",
    ];
  }

  private shares(plan: Plan): void {
    const place = byId("plan-known");
    if (place.children.length !== plan.known.length) {
      place.replaceChildren(...plan.known.map(() => {
        const item = document.createElement("li");
        item.append(document.createElement("b"), document.createElement("span"));
        return item;
      }));
    }
    plan.known.forEach((each, k) => {
      const item = place.children[k] as HTMLElement;
      item.dataset.met = String(each.met);
      write(item.children[0], each.name);
      write(item.children[1], each.share === null ? "not yet" : `${percent(each.share)}${each.met ? " ✓" : ""}`);
    });
  }

  /** Draw the movements as blocks over time, one row an axis: above its line forward, right, down. */
  private paint(plan: Plan): void {
    const key = JSON.stringify([plan.segment, plan.movements]);
    if (key === this.drawn) return;
    this.drawn = key;
    const whole = plan.duration_s + LEAD;
    const height = TALL * plan.axes.length;
    const largest = Math.max(...plan.movements.map((each) => Math.abs(each.amount)), 0.01);
    const blocks = plan.movements.map((each) => {
      const row = plan.axes.indexOf(each.axis);
      const tall = Math.max(Math.abs(each.amount) / largest, 0.25) * (TALL / 2 - 1.5);
      const middle = (row + 0.5) * TALL;
      const state = each.done === null ? "coming" : each.done >= DONE ? "done" : "missed";
      return draw("rect", {
        x: ((each.start_s + LEAD) / whole) * WIDE, width: ((each.end_s - each.start_s) / whole) * WIDE - 0.15,
        y: each.amount > 0 ? middle - tall : middle, height: tall, class: state,
      });
    });
    const lines = plan.axes.map((_, row) => draw("line", { x1: 0, x2: WIDE, y1: (row + 0.5) * TALL, y2: (row + 0.5) * TALL, class: "rest" }));
    this.cursor = draw("line", { x1: 0, x2: 0, y1: 0, y2: height, class: "cursor" });
    const picture = draw("svg", { viewBox: `0 0 ${WIDE} ${Math.max(height, 1)}`, preserveAspectRatio: "none" }, ...lines, ...blocks, this.cursor);
    picture.style.height = `${2 * height}px`;
    const names = plan.axes.map((axis) => {
      const name = document.createElement("span");
      name.textContent = axis;
      return name;
    });
    const labels = document.createElement("div");
    labels.append(...names);
    this.line.replaceChildren(...(plan.axes.length ? [labels, picture] : []));
  }
}
