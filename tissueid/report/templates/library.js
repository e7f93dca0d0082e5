"use strict";
// The drawing library stands in the page deflated (RFC 1951) and is inflated before anything is drawn: a page
// that is sent by mail is then less than half as large. At once, not in a stream, so that a printer waits.
const bytesOf = (text) => {
  const raw = atob(text), found = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i += 1) found[i] = raw.charCodeAt(i);
  return found;
};
const inflate = (bytes, size) => {
  const out = new Uint8Array(size);
  let filled = 0, place = 0, held = 0, bits = 0;
  const fill = (wanted) => { while (bits < wanted) { held |= (place < bytes.length ? bytes[place] : 0) << bits; place += 1; bits += 8; } };
  const take = (count) => {
    fill(count);
    const value = held & ((1 << count) - 1);
    held >>>= count; bits -= count;
    return value;
  };
  // a canonical code as a table by its next bits: symbol times 16, plus how many bits it takes
  const code = (lengths) => {
    const most = lengths.reduce((a, b) => Math.max(a, b), 1), next = new Uint16Array(most + 2), found = new Uint16Array(1 << most);
    for (const length of lengths) if (length) next[length + 1] += 1;
    for (let length = 1; length <= most + 1; length += 1) next[length] = (next[length] + next[length - 1]) << 1;
    lengths.forEach((length, symbol) => {
      if (!length) return;
      let reversed = 0;
      for (let k = 0, value = next[length]; k < length; k += 1, value >>= 1) reversed = (reversed << 1) | (value & 1);
      next[length] += 1;
      for (let entry = reversed; entry < found.length; entry += 1 << length) found[entry] = (symbol << 4) | length;
    });
    return { found, most };
  };
  const symbol = ({ found, most }) => {
    fill(most);
    const entry = found[held & (found.length - 1)];
    held >>>= entry & 15; bits -= entry & 15;
    return entry >> 4;
  };
  const LENGTH = [3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227, 258];
  const LENGTH_BITS = [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0];
  const BACK = [1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025, 1537, 2049, 3073, 4097, 6145, 8193, 12289, 16385, 24577];
  const ORDER = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];
  const fixed = () => [code(Array.from({ length: 288 }, (_, i) => (i < 144 ? 8 : i < 256 ? 9 : i < 280 ? 7 : 8))), code(new Array(30).fill(5))];
  const described = () => {
    const literals = take(5) + 257, distances = take(5) + 1, count = take(4) + 4, first = new Array(19).fill(0), lengths = [];
    for (let i = 0; i < count; i += 1) first[ORDER[i]] = take(3);
    const by = code(first);
    while (lengths.length < literals + distances) {
      const what = symbol(by);
      if (what < 16) lengths.push(what);
      else {
        const again = what === 16 ? lengths[lengths.length - 1] : 0;
        for (let left = what === 16 ? take(2) + 3 : what === 17 ? take(3) + 3 : take(7) + 11; left > 0; left -= 1) lengths.push(again);
      }
    }
    return [code(lengths.slice(0, literals)), code(lengths.slice(literals))];
  };
  const stored = () => {
    place -= bits >> 3; held = 0; bits = 0;
    const length = bytes[place] | (bytes[place + 1] << 8);
    out.set(bytes.subarray(place + 4, place + 4 + length), filled);
    place += 4 + length; filled += length;
  };
  for (let last = 0; !last;) {
    last = take(1);
    const kind = take(2);
    if (kind === 0) { stored(); continue; }
    const [literal, distance] = kind === 1 ? fixed() : described();
    for (let what = symbol(literal); what !== 256; what = symbol(literal)) {
      if (what < 256) { out[filled] = what; filled += 1; continue; }
      const length = LENGTH[what - 257] + take(LENGTH_BITS[what - 257]), far = symbol(distance);
      const back = BACK[far] + take(far < 4 ? 0 : (far >> 1) - 1);
      for (let k = 0; k < length; k += 1, filled += 1) out[filled] = out[filled - back];
    }
  }
  return out;
};
(() => {
  const box = document.getElementById("library"), script = document.createElement("script");
  script.textContent = new TextDecoder().decode(inflate(bytesOf(box.textContent), Number(box.dataset.size)));
  document.head.append(script);
  box.remove();
})();
