// Numbers as text, with as many digits as they are worth; the same rules as in towtank's tables.

const DIGITS = 6;

/** A number with so many significant digits and no needless zeros; "–" where there is none. */
export function short(value: number | null | undefined, digits = 4): string {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (value === 0) return "0";
  const size = Math.log10(Math.abs(value));
  if (digits <= size && size < 7) return value.toFixed(0);
  const text = value.toPrecision(digits);
  if (text.includes("e")) {
    const [number, power] = text.split("e");
    return `${trimmed(number)}e${power}`;
  }
  return trimmed(text);
}

function trimmed(text: string): string {
  return text.includes(".") ? text.replace(/\.?0+$/, "") : text;
}

/** Value and deviation: the deviation with two digits, the value with as many places. */
export function measured(value: number, std: number | null): [string, string] {
  if (std === null || !Number.isFinite(std)) return [short(value, DIGITS), ""];
  if (std <= 0) return [short(value, DIGITS), "0"];
  let places = 1 - Math.floor(Math.log10(std));
  if (value) places = Math.min(places, DIGITS - 1 - Math.floor(Math.log10(Math.abs(value))));
  if (places > 12 || places < -6) return [short(value, DIGITS), short(std, 2)];
  if (places <= 0) return [value.toFixed(0), std.toFixed(0)];
  const spread = std.toFixed(places);
  return [value.toFixed(places), Number(spread) > 0 ? spread : std.toPrecision(1)];
}

/** A share as percent, with two digits. */
export function percent(share: number | null | undefined): string {
  if (share === null || share === undefined || !Number.isFinite(share)) return "–";
  return share < 10 ? `${short(100 * share, 2)} %` : "> 1000 %";
}

/** A unit with its powers raised. */
export function unit(text: string): string {
  return text.replace(/\^2/g, "²").replace(/\^3/g, "³");
}

/** A duration as 1:02:03. */
export function clock(seconds: number): string {
  const whole = Math.floor(seconds);
  const two = (n: number) => String(n).padStart(2, "0");
  return `${Math.floor(whole / 3600)}:${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
}

/** A size of a file. */
export function bytes(count: number): string {
  return count >= 1e5 ? `${(count / 1e6).toFixed(1)} MB` : `${(count / 1e3).toFixed(1)} kB`;
}
