// Numbers over time in constant memory.

/** The newest rows: when there is no more room, the older half is given up. */
export class Recent {
  readonly t: Float64Array;
  readonly columns: Float32Array[];
  count = 0;
  total = 0; // rows ever taken

  constructor(width: number, readonly room: number) {
    this.t = new Float64Array(2 * room);
    this.columns = Array.from({ length: width }, () => new Float32Array(2 * room));
  }

  add(t: Float64Array, columns: Float32Array[]): void {
    const from = Math.max(0, t.length - this.room);
    const n = t.length - from;
    if (this.count + n > 2 * this.room) {
      const kept = this.room - n;
      this.t.copyWithin(0, this.count - kept, this.count);
      for (const column of this.columns) column.copyWithin(0, this.count - kept, this.count);
      this.count = kept;
    }
    this.t.set(from ? t.subarray(from) : t, this.count);
    this.columns.forEach((column, k) => column.set(from ? columns[k].subarray(from) : columns[k], this.count));
    this.count += n;
    this.total += n;
  }

  get last(): number {
    return this.count ? this.t[this.count - 1] : NaN;
  }

  /** Row numbers of the last `seconds`, at most about `most`, the same ones from one look to the next. */
  rows(seconds: number, most: number): number[] {
    const start = this.last - seconds;
    let first = this.count;
    while (first > 0 && this.t[first - 1] >= start) first--;
    const stride = Math.max(1, 2 ** Math.ceil(Math.log2((this.count - first) / most)));
    const phase = (this.total - this.count + first) % stride;
    const rows: number[] = [];
    for (let k = first + ((stride - phase) % stride); k < this.count; k += stride) rows.push(k);
    return rows;
  }
}

/** Rows over hours: when there is no more room, every second one is given up. */
export class Course {
  t: number[] = [];
  columns: number[][];
  private step = 0;

  constructor(readonly width: number, readonly room = 4096) {
    this.columns = Array.from({ length: width }, () => []);
  }

  add(t: Float64Array, columns: Float32Array[]): void {
    for (let k = 0; k < t.length; k++) {
      if (this.t.length && t[k] - this.t[this.t.length - 1] < this.step) continue;
      if (this.t.length >= this.room) this.halve();
      this.t.push(t[k]);
      this.columns.forEach((column, j) => column.push(columns[j][k]));
    }
  }

  private halve(): void {
    const span = this.t[this.t.length - 1] - this.t[0];
    const half = <T>(values: T[]) => values.filter((_, k) => k % 2 === 0);
    this.t = half(this.t);
    this.columns = this.columns.map(half);
    this.step = span / this.t.length;
  }
}
