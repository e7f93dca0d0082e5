const ws = new WebSocket(`ws://${location.host}/ws${location.search}`);
ws.binaryType = "arraybuffer";
let n = 0;
ws.onmessage = (m) => {
  if (typeof m.data === "string") { window.hello = JSON.parse(m.data); return; }
  n += 1;
  const v = new DataView(m.data);
  const count = v.getUint32(4, true);
  const at = 32 + (count - 1) * 72;
  document.getElementById("force").textContent = count ? v.getFloat32(at + 40, true).toFixed(3) : "";
  ws.send(JSON.stringify({ v: 1, answer: n }));
};
