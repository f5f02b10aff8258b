// What the server sends: binary frames of numbers, and JSON for the rest. See docs/design/page.md.

export interface Coefficient {
  name: string; unit: string; axis: string; reference: number | null; earlier: number | null;
}
export interface Signal { name: string; chart: string; unit: string; scale: number }

export interface Hello {
  type: "hello"; session: string; title: string; vehicle: string; method: string; seconds: number | null; report: boolean;
  prediction_seconds: number; reference_word: string; reference_since: number | null; coefficients: Coefficient[]; signals: Signal[];
  axes: { name: string; velocity: string; wrench: string }[];
}

export interface Known {
  learned: boolean; known: number | null; inertia: number | null; drag: number | null; speed: number | null;
  asked_rms: number | null; drivable: boolean;
}

export interface Movement {
  axis: string; text: string; amount: number; start_s: number; end_s: number; done: number | null;
}

export interface Plan {
  stage: "bring" | "count" | "drive" | "think" | "held" | "met" | "over"; text: string; clock_s: number | null;
  segment: number; planned: number; duration_s: number; manoeuvred_s: number; accuracy: number; offset_m: number[];
  axes: string[]; movements: Movement[]; known: { name: string; share: number | null; met: boolean }[];
  drive?: Drive;
}

export interface Drive {
  stage: "off" | "ready" | "driving" | "stopping"; text: string; held: boolean; guarded: boolean; walls: string;
}

export interface State {
  type: "state"; sequence: number; ended: boolean; paused: boolean; state: string; no_data_s: number | null; elapsed_s: number;
  t: number | null; verdict: string; notes: string[];
  coefficients: Record<string, {
    value: number | null; std: number | null; relative_std: number | null; unit: string; identified: boolean;
    reason: string | null;
  }>;
  axes: Record<string, Known>;
  prediction: { rms: (number | null)[]; t: number[]; derived: string[] } | null;
  pose: (number | null)[];
  delay_s: number | null; lag_s: number | null;
  latency_ms: Record<string, number | null>; processing_ms: Record<string, number | null>;
  samples: number; instants: number; dropped: number; late: number; rejected: number; waiting: number;
  links: {
    text: string; samples: number; rates_hz: Record<string, number | null>; asked_hz: Record<string, number | null>;
    said: string[]; no_data_s: number | null;
  }[];
  recording: { file: string; bytes: number; lost: number } | null;
  warnings: string[];
  plan: Plan | null;
  page: { viewers: number; skipped: number; refused: number; trouble: string };
}

export interface Happening { t: number; kind: string; text: string }
export interface Events { type: "events"; events: Happening[] }
export interface You { type: "you"; steers: boolean }
export type Message = Hello | State | Events | You;

export enum Kind { Signals = 1, Coefficients = 2, Prediction = 3, Track = 4 }

export interface Frame { kind: Kind; sequence: number; t: Float64Array; columns: Float32Array[] }

// Controls, marks of direction and what is not seen, as a terminal's output has them written out (towtank.printable).
const STEERING = new RegExp(
  "[\\u0000-\\u0008\\u000b-\\u001f\\u007f-\\u009f\\u061c\\u200e\\u200f\\u202a-\\u202e\\u2066-\\u2069" +
  "\\u200b\\u2028\\u2029\\u2060-\\u2064\\ufeff\\ufff9-\\ufffb\\u{e0000}-\\u{e007f}\\ud800-\\udfff]",
  "gu",
);

function printable(text: string): string {
  return text.replace(STEERING, (each) => {
    const code = each.codePointAt(0)!;
    return code < 0x100 ? `\\x${code.toString(16).padStart(2, "0")}` : `\\u${code.toString(16).padStart(4, "0")}`;
  });
}

/** Read a message, in which no text can turn a line round or hide: names and status texts are others'. */
export function parse(data: string): Message {
  return JSON.parse(data, (_, value: unknown) => {
    if (typeof value === "string") return printable(value);
    if (value === null || typeof value !== "object" || Array.isArray(value)) return value;
    return Object.fromEntries(Object.entries(value).map(([key, each]) => [printable(key), each]));
  }) as Message;
}

const HEADER = 16;
const VERSION = 1;

/** Take a frame apart; null where it is none of this version. */
export function decode(data: ArrayBuffer): Frame | null {
  if (data.byteLength < HEADER) return null;
  const head = new DataView(data, 0, HEADER);
  const count = head.getUint16(2, true);
  const rows = head.getUint32(4, true);
  if (head.getUint8(0) !== VERSION || data.byteLength !== HEADER + rows * (8 + 4 * count)) return null;
  const columns = Array.from({ length: count }, (_, k) => new Float32Array(data, HEADER + rows * (8 + 4 * k), rows));
  return { kind: head.getUint8(1), sequence: head.getUint32(8, true), t: new Float64Array(data, HEADER, rows), columns };
}
