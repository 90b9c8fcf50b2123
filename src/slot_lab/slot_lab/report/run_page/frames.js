// Frames of a run: decoded from the page's content, and the row of numbers at any time.

const NO_VALUE = -2147483648;

async function inflated(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

class Run {
  // columns: place of each column by name; table: (frames, width) numbers, NaN where not known
  constructor(coded, bytes) {
    Object.assign(this, { name: coded.name, frames: coded.frames, states: coded.states });
    Object.assign(this, { known: coded.known, thickness: coded.thickness });
    this.columns = {};
    let width = 0;
    for (const [name, count] of coded.columns) {
      this.columns[name] = { at: width, count };
      width += count;
    }
    this.width = width;
    this.nodes = this.columns.nodes.count / 12;
    const integers = this.integers(bytes);
    this.table = new Float32Array(this.frames * width);
    let column = 0;
    for (const [, count, step] of coded.columns) {
      for (const end = column + count; column < end; column++) {
        for (let f = 0; f < this.frames; f++) {
          const value = integers[column * this.frames + f];
          this.table[f * width + column] = value === NO_VALUE ? NaN : value * step;
        }
      }
    }
    this.row = new Float32Array(width);
  }

  // Integers of all columns, one column after the other; see run_frames.py.
  integers(bytes) {
    const { frames, nodes } = this, total = frames * this.width, found = new Int32Array(total);
    for (let k = 0; k < total; k++) {
      const signed = bytes[k] | (bytes[total + k] << 8) | (bytes[2 * total + k] << 16)
        | (bytes[3 * total + k] << 24);
      const change = (signed >>> 1) ^ -(signed & 1);
      found[k] = k % frames ? found[k - 1] + change : change;
    }
    for (const { at, count } of [this.columns.nodes, this.columns.across]) {
      for (let column = 3; column < count; column++) {
        if (Math.floor(column / 3) % nodes === 0) continue; // the first node of a leg
        for (let k = (at + column) * frames, end = k + frames; k < end; k++) {
          found[k] += found[k - 3 * frames];
        }
      }
    }
    return found;
  }

  static async read(coded) {
    return new Run(coded, await inflated(coded.data));
  }

  get duration() {
    return this.table[(this.frames - 1) * this.width];
  }

  time(frame) {
    return this.table[frame * this.width];
  }

  // last frame at or before a time
  frame(t) {
    let low = 0, high = this.frames - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.time(middle) <= t) low = middle; else high = middle - 1;
    }
    return low;
  }

  // place of a time in the table: start of a row, and share of the way to the next
  place(t) {
    const f = this.frame(t);
    if (f + 1 >= this.frames) return [f * this.width, 0];
    const share = (t - this.time(f)) / (this.time(f + 1) - this.time(f));
    return [f * this.width, Math.max(0, share)];
  }

  // number of a column at a place
  between(column, [start, share]) {
    const a = this.table[start + column], b = share ? this.table[start + this.width + column] : a;
    return Number.isNaN(b) ? a : a + share * (b - a);
  }

  // number of a column at a time, between two frames in proportion
  at(column, t) {
    return this.between(column, this.place(t));
  }

  // all columns at a time; the array is used again by the next call
  rowAt(t) {
    const place = this.place(t);
    for (let c = 0; c < this.width; c++) this.row[c] = this.between(c, place);
    return this.row;
  }

  // state at a time by its title
  statesAt(t) {
    return Object.entries(this.states).map(([title, changes]) => {
      const known = changes.filter(([since]) => since <= t + 1e-6);
      return [title, known.length ? known[known.length - 1][1] : "-"];
    });
  }
}
