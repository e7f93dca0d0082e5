// Marks, and what is kept of a session on this machine: the last minute as CSV, the scene as PNG.

const stamp = () => new Date().toISOString().slice(0, 19).replaceAll(":", "-");

function download(name, blob) {
  const href = URL.createObjectURL(blob);
  Object.assign(document.createElement("a"), { href, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(href), 10_000);
}

/** Samples of a history as lines of CSV behind remarks. */
export function asCsv(hello, history, end, marks) {
  const { session } = hello;
  const names = history.columns.map(([name]) => name);
  const oneLine = (text) => text.replaceAll(/[\r\n]+/g, " ");
  const lines = [
    `# ${oneLine(session.title)}, device ${session.device.name}, started ${session.started}`,
    ...(session.scale ? [`# force scale ${session.scale.force_scale}, motion scale ${session.scale.motion_scale}`] : []),
    ...marks.map((mark) => `# mark at ${mark.time_s.toFixed(3)} s: ${oneLine(mark.text)}`),
    names.join(","),
  ];
  for (let n = history.begin; n < end; n += 1) lines.push(names.map((name) => history.value(name, n)).join(","));
  return `${lines.join("\n")}\n`;
}

export function saveData(hello, history, end, marks) {
  download(`tissueid-${stamp()}.csv`, new Blob([asCsv(hello, history, end, marks)], { type: "text/csv" }));
}

export async function savePicture(scene) {
  download(`tissueid-${stamp()}.png`, await scene.picture());
}
