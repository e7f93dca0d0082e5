// The last minute of samples, column by column, addressed by their number since the session began.

import { readSamples } from "./frames.js";

const CAPACITY = 1 << 16;
const MASK = CAPACITY - 1;

export class History {
  constructor(hello) {
    // name, method of a DataView and offset of each
    this.columns = hello.sample.columns;
    this.sampleBytes = hello.sample.bytes;
    this.periodS = hello.session.period_s;
    this.data = this.columns.map(() => new Float64Array(CAPACITY));
    this.index = new Map(this.columns.map(([name], c) => [name, c]));
    this.besides = hello.beside;
    this.begin = 0;
    this.end = 0;
  }

  /** A column of the recording beside the session, at the time of a sample; null before and after it. */
  beside(name) {
    const { time_s: times, [name]: values } = this.besides;
    return (n) => {
      const time = this.value("time_s", n);
      if (!(time >= times[0] && time <= times.at(-1))) return null;
      let low = 0;
      let high = times.length - 1;
      while (high - low > 1) {
        const middle = (low + high) >> 1;
        if (times[middle] <= time) low = middle;
        else high = middle;
      }
      return values[low] + ((values[high] - values[low]) * (time - times[low])) / (times[high] - times[low]);
    };
  }

  /** Take a frame in; samples that were left out are NaN. */
  add(buffer, head) {
    if (head.first < this.end || head.first - this.end > CAPACITY) this.begin = this.end = head.first;
    for (let n = this.end; n < head.first; n += 1) for (const column of this.data) column[n & MASK] = NaN;
    readSamples(buffer, head, this.columns, this.sampleBytes, (c, i, value) => {
      this.data[c][(head.first + i) & MASK] = value;
    });
    this.end = head.first + head.count;
    this.begin = Math.max(this.begin, this.end - CAPACITY);
  }

  get size() {
    return this.end - this.begin;
  }

  /** Function of a sample's number: a field's value, or a vector's length. */
  reader(field) {
    if (this.index.has(field)) {
      const column = this.data[this.index.get(field)];
      return (n) => column[n & MASK];
    }
    const parts = [0, 1, 2].map((part) => this.data[this.index.get(`${field}.${part}`)]);
    return (n) => Math.hypot(parts[0][n & MASK], parts[1][n & MASK], parts[2][n & MASK]);
  }

  /** The three components of a field. */
  vector(field, n) {
    return [0, 1, 2].map((part) => this.data[this.index.get(`${field}.${part}`)][n & MASK]);
  }

  value(field, n) {
    return this.data[this.index.get(field)][n & MASK];
  }

  /** A trace of the hello as a function of a sample's number. */
  trace(trace) {
    if (trace.beside) return this.beside(trace.beside);
    const read = this.reader(trace.field);
    const minus = trace.minus_period ? this.periodS : 0;
    const factor = trace.factor ?? 1;
    return minus === 0 && factor === 1 ? read : (n) => (read(n) - minus) * factor;
  }

  /** Numbers of the samples worth drawing: the least and the greatest of each of some hundred groups. */
  picked(read, begin, end, groups) {
    const length = Math.max(1, Math.ceil((end - begin) / groups));
    const picked = [];
    for (let at = Math.floor(begin / length) * length; at < end; at += length) {
      let low = -1;
      let high = -1;
      for (let n = Math.max(at, begin); n < Math.min(at + length, end); n += 1) {
        const value = read(n);
        if (Number.isNaN(value)) continue;
        if (low < 0 || value < read(low)) low = n;
        if (high < 0 || value > read(high)) high = n;
      }
      if (low < 0) continue;
      picked.push(Math.min(low, high));
      if (low !== high) picked.push(Math.max(low, high));
    }
    return picked;
  }

  /** Number of the first sample not older than a time; NaN gaps are passed over. */
  since(timeS) {
    let low = this.begin;
    let high = this.end;
    while (low < high) {
      const middle = (low + high) >> 1;
      let probe = middle;
      while (probe < high && Number.isNaN(this.value("time_s", probe))) probe += 1;
      if (probe < high && this.value("time_s", probe) < timeS) low = probe + 1;
      else high = middle;
    }
    return low;
  }
}
