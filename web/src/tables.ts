// What stands in words and tables: how well axes are known, links, events.

import { byId, fill, list, write } from "./dom";
import { bytes, percent, short } from "./numbers";
import type { Happening, Hello, State } from "./protocol";

const WELL = 0.05;
const DEGREES = 180 / Math.PI;

export function showAxes(hello: Hello, state: State): void {
  const body = document.querySelector("#known tbody")!;
  const rows = hello.axes.map((axis, k) => {
    const found = state.axes[axis.name];
    const turning = k > 2;
    const wanted = found && !found.drivable ? "no thruster" : asked(found?.asked_rms, turning);
    if (!found?.learned) return [axis.name, "not learned", "", "–", "–", wanted];
    const speed = found.speed ? `${short(found.speed * (turning ? DEGREES : 1), 2)} ${turning ? "°/s" : "m/s"}: ` : "";
    const drag = found.drag === null ? "–" : `${speed}${percent(found.drag)}`;
    const known = found.known === null ? "not yet" : percent(found.known);
    return [axis.name, known, "", percent(found.inertia), drag, wanted];
  });
  fill(body, rows, [3, 4, 5]);
  hello.axes.forEach((axis, k) => {
    const cell = body.children[k].children[2] as HTMLElement;
    const known = state.axes[axis.name]?.known;
    let meter = cell.querySelector<HTMLElement>(".bar");
    if (!meter) {
      meter = document.createElement("div");
      meter.className = "bar";
      meter.setAttribute("aria-hidden", "true");
      meter.append(document.createElement("i"));
      cell.replaceChildren(meter);
    }
    // 100 % and worse: empty; 0.1 %: full
    const share = known ? Math.min(Math.max(-Math.log10(known) / 3, 0.02), 1) : 0;
    (meter.firstElementChild as HTMLElement).style.width = `${(100 * share).toFixed(0)}%`;
    meter.dataset.well = String(known != null && known <= WELL);
  });
}

function asked(rms: number | null | undefined, turning: boolean): string {
  return rms ? `${short(rms, 2)} ${turning ? "N m" : "N"}` : "–";
}

export function showLinks(state: State): void {
  const ms = (value: number | null | undefined) => (value == null ? "–" : `${short(value, 3)} ms`);
  const seconds = (value: number | null) => (value === null ? "not known yet" : `${(1000 * value).toFixed(1)} ms`);
  const recording = state.recording;
  const told: [string, string][] = [
    ["Samples", `${state.samples}, learned from ${state.instants} instants`],
    ["Delay, command to force", seconds(state.delay_s)],
    ["Lag of the thrusters", state.lag_s === null ? "–" : seconds(state.lag_s)],
    ["Latency, median", ms(state.latency_ms.median)],
    ["Latency, 99 %", ms(state.latency_ms.p99)],
    ["Dropped", String(state.dropped)],
    ["Late", String(state.late)],
    ["Rejected", String(state.rejected)],
    ["Recording", recording ? `${recording.file}, ${bytes(recording.bytes)}${recording.lost ? `, ${recording.lost} lost` : ""}` : "none"],
    ["Viewers", `${state.page.viewers}${state.page.skipped ? `, ${state.page.skipped} frames skipped for slow ones` : ""}`],
  ];
  const place = byId("numbers");
  if (place.children.length !== told.length)
    place.replaceChildren(...told.map(([name]) => {
      const entry = document.createElement("div");
      entry.append(document.createElement("dt"), document.createElement("dd"));
      entry.firstElementChild!.textContent = name;
      return entry;
    }));
  told.forEach(([, value], k) => write(place.children[k].lastElementChild!, value));
  const rows = state.links.flatMap((link) => {
    const topics = [...new Set([...Object.keys(link.rates_hz), ...Object.keys(link.asked_hz)])].sort();
    const several = state.links.length > 1;
    if (link.no_data_s !== null && !state.ended) return [[link.text, `no data since ${Math.floor(link.no_data_s)} s`, "–"]];
    if (!topics.length) return [[link.text, "–", "–"]];
    return topics.map((topic) => [
      several ? `${link.text} ${topic}` : topic, short(link.rates_hz[topic] ?? null, 3), short(link.asked_hz[topic] ?? null, 3),
    ]);
  });
  fill(document.querySelector("#links tbody")!, rows, [1, 2]);
}

const NOTES = 3; // that stand open

export function showWarnings(warnings: string[]): void {
  list(byId("warnings"), warnings);
}

/** What befell filter and links, each once with how often; what is beyond a few can be unfolded. */
export function showNotes(notes: string[]): void {
  byId("notes").hidden = notes.length === 0;
  const open = notes.length > NOTES + 1 ? NOTES : notes.length;
  list(byId("notes-first"), notes.slice(0, open));
  const more = byId("notes-more");
  more.hidden = open === notes.length;
  write(more.querySelector("summary")!, `${notes.length - open} more notes`);
  list(more.querySelector("ul")!, notes.slice(open));
}

let count = 0;

export function showEvents(events: Happening[]): void {
  const body = document.querySelector("#events tbody")!;
  fill(body, [...events].reverse().map((event) => [event.t.toFixed(1), event.kind, event.text]), [0]);
  byId("no-events").hidden = events.length > 0;
  document.querySelector<HTMLElement>("#events table")!.hidden = events.length === 0;
  const latest = events[events.length - 1];
  if (latest && events.length !== count) write(byId("latest-event"), `${latest.kind}: ${latest.text}`);
  count = events.length;
}
