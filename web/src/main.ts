// The page: what comes through the link is kept, and drawn in step with the screen.

import "./style.css";
import { charts } from "./chart";
import { Coefficients } from "./coefficients";
import { Controls } from "./controls";
import { byId, hintScroll, write } from "./dom";
import { Drive } from "./drive";
import { Link } from "./link";
import { Pilot } from "./pilot";
import { clock } from "./numbers";
import type { Frame, Hello, Message, State } from "./protocol";
import { Kind } from "./protocol";
import { Course, Recent } from "./series";
import { showAxes, showEvents, showLinks, showNotes, showWarnings } from "./tables";
import { Horizon, Track } from "./vehicle";
import { Signals, Velocities } from "./velocity";

const ROWS = 2500; // of signals: 20 s at 100 Hz, and some
const QUIET = 2; // s without a word of the session, after which nothing on the page is of now
const STEADY = 3; // s, after which a screen reader is not told every second that nothing has come

let hello: Hello | null = null;
let state: State | null = null;
let prediction: Frame | null = null;
let marks: number[] = [];
let recent = new Recent(0, ROWS);
let course = new Course(0);
let track = new Course(3);
const fresh = { signals: false, course: false, prediction: false };

const controls = new Controls();
const coefficients = new Coefficients(() => marks);
const velocities = new Velocities();
const signals = new Signals();
const horizon = new Horizon(byId("horizon"));
const trail = new Track(byId("track"));
const pilot = new Pilot((what) => void controls.post(what));
const drive = new Drive((what) => controls.post(what));

// The token is in a cookie by now; it had better not stay in the address.
if (new URLSearchParams(location.search).has("token")) history.replaceState(null, "", location.pathname);

function say(link: string, text: string): void {
  const chip = byId("link");
  chip.dataset.link = link;
  write(chip, text);
}

function judge(verdict: string, stale: boolean, seconds: number): void {
  const place = byId("verdict");
  place.dataset.stale = String(stale);
  place.setAttribute("aria-live", stale && seconds > STEADY ? "off" : "polite");
  write(place, verdict);
}

/** Where the session itself is not heard of: nothing that stands on the page is of now. */
function watch(): void {
  if (link.quiet <= QUIET || state?.ended) return;
  const words = `no word from the session since ${Math.floor(link.quiet)} s`;
  judge(`Connection lost: ${words}. All figures are as of then.`, true, link.quiet);
  if (byId("link").dataset.link !== "lost") say("silent", words);
  if (state) velocities.show(state, `no word since ${Math.floor(link.quiet)} s`);
}

function reset(): void {
  hello = state = prediction = null;
  marks = [];
  recent = new Recent(0, ROWS);
  course = new Course(0);
  track = new Course(3);
}

function greet(next: Hello): void {
  const names = (each: Hello | null) => JSON.stringify([each?.coefficients.map((one) => one.name), each?.signals]);
  const same = names(hello) === names(next);
  hello = next;
  write(byId("title"), next.title);
  write(byId("about"), `${next.vehicle}, method ${next.method}`);
  document.title = `${next.vehicle}: towtank`;
  controls.greet(next);
  fresh.course = true;
  if (same) return;
  coefficients.greet(next);
  velocities.greet(next);
  signals.greet(next);
  course = new Course(2 * next.coefficients.length);
  if (recent.columns.length !== next.signals.length) recent = new Recent(next.signals.length, ROWS);
}

function stand(next: State): void {
  state = next;
  if (!hello) return;
  const silent = next.no_data_s !== null && !next.ended;
  const kind = next.ended ? "ended" : silent ? "silent" : next.state === "learning" ? "open" : "paused";
  say(kind, next.ended ? "session ended" : next.state);
  write(byId("clock"), hello.seconds ? `${clock(next.t ?? 0)} of ${clock(hello.seconds)}` : clock(next.elapsed_s));
  judge(next.verdict, silent, next.no_data_s ?? 0);
  showWarnings(next.page.trouble ? [...next.warnings, next.page.trouble] : next.warnings);
  showNotes(next.notes);
  coefficients.show(hello, next);
  velocities.show(next, silent ? next.state : "");
  showAxes(hello, next);
  showLinks(next);
  controls.show(next);
  pilot.show(next.ended ? null : next.plan, controls.able);
  drive.show(next.ended ? null : next.plan?.drive, controls.able);
  document.body.dataset.sequence = String(next.sequence); // last: everything of this state stands there now
}

function message(next: Message): void {
  if (next.type === "hello") greet(next);
  else if (next.type === "state") stand(next);
  else if (next.type === "you") controls.you(next.steers);
  else {
    showEvents(next.events);
    marks = next.events.map((event) => event.t);
    fresh.course = true;
  }
}

function frame(next: Frame): void {
  const width = next.columns.length;
  if (next.kind === Kind.Signals && width === recent.columns.length) {
    recent.add(next.t, next.columns);
    fresh.signals = true;
  } else if (next.kind === Kind.Coefficients && width === course.width) {
    course.add(next.t, next.columns);
    fresh.course = true;
  } else if (next.kind === Kind.Track) {
    track.add(next.t, next.columns);
  } else if (next.kind === Kind.Prediction) {
    prediction = next;
    fresh.prediction = true;
  }
}

function pose(): number[] {
  const found = [0, 1, 2, 3, 4, 5].map((k) => {
    const column = recent.columns[k];
    for (let row = recent.count - 1; row >= Math.max(recent.count - 50, 0); row--) if (column[row] === column[row]) return column[row];
    return NaN;
  });
  return found.map((value, k) => (Number.isNaN(value) ? (state?.pose[k] ?? NaN) : value));
}

const drawn = { frames: 0, charts };
Object.assign(window, { towtank: drawn });

function draw(): void {
  requestAnimationFrame(draw);
  if (!hello) return;
  pilot.draw();
  let any = false;
  if (fresh.signals && recent.columns.length) {
    const [, , , phi, theta, psi] = pose();
    any = horizon.draw(phi, theta, psi) || any;
    any = trail.draw(track, recent, psi) || any;
    byId("no-motion").hidden = !byId("horizon").hidden || !byId("track").hidden;
    signals.draw(recent);
  }
  if (fresh.course) coefficients.draw(hello, course);
  if (fresh.prediction && prediction) velocities.draw(prediction);
  fresh.signals = fresh.course = fresh.prediction = false;
  for (const chart of charts) any = chart.draw() || any;
  if (any) drawn.frames++;
}

const link = new Link({
  opened: () => {
    reset();
    controls.link(true);
    say("open", "connected");
  },
  message,
  frame,
  waiting: (seconds) => {
    controls.link(false);
    const again = `trying again in ${Math.max(1, Math.round(seconds))} s`;
    say("lost", state?.ended ? "session ended" : `no connection, ${again}`);
  },
});
setInterval(watch, 250);
for (const box of document.querySelectorAll<HTMLElement>(".scroll")) hintScroll(box);
requestAnimationFrame(draw);
