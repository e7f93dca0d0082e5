// Frames of the websocket, read by the layout that the hello gives; see tissueid/viewer/frames.py.

const HEAD_BYTES = 32;
const MAGIC = 0x4654; // "TF", little-endian
const VERSION = 1;
const ENDED = 1;

/** The head of a frame; null where it is none of this version. */
export function readHead(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < HEAD_BYTES || view.getUint16(0, true) !== MAGIC || view.getUint8(2) !== VERSION) return null;
  return {
    ended: (view.getUint8(3) & ENDED) !== 0,
    count: view.getUint32(4, true),
    first: Number(view.getBigUint64(8, true)),
    dropped: view.getUint32(16, true),
    roundTripS: view.getUint32(20, true) * 1e-6,
    nowS: view.getFloat64(24, true),
  };
}

/** Calls put(column, index, value) for every number of a frame. */
export function readSamples(buffer, head, columns, sampleBytes, put) {
  const view = new DataView(buffer);
  for (let c = 0; c < columns.length; c += 1) {
    const [, read, offset] = columns[c];
    for (let i = 0; i < head.count; i += 1) put(c, i, view[read](HEAD_BYTES + i * sampleBytes + offset, true));
  }
}
