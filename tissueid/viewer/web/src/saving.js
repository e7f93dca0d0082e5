// Marks, and what is kept of a session on this machine: the last minute as CSV, the scene as PNG.

const stamp = () => new Date().toISOString().slice(0, 19).replaceAll(":", "-");

function download(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** Samples of a history as lines of CSV behind remarks. */
export function asCsv(hello, history, end, marks) {
  const { session } = hello;
  const oneLine = (text) => text.replaceAll(/[\r\n]+/g, " ");
  const lines = [
    `# ${oneLine(session.title)}, device ${session.device.name}, started ${session.started}`,
    ...(session.scale ? [`# force scale ${session.scale.force_scale}, motion scale ${session.scale.motion_scale}`] : []),
    ...marks.map((mark) => `# mark at ${mark.time_s.toFixed(3)} s: ${oneLine(mark.text)}`),
    history.columns.map((column) => column.name).join(","),
  ];
  for (let n = history.begin; n < end; n += 1) lines.push(history.columns.map((column) => history.value(column.name, n)).join(","));
  return `${lines.join("\n")}\n`;
}

export function saveData(hello, history, end, marks) {
  download(`tissueid-${stamp()}.csv`, new Blob([asCsv(hello, history, end, marks)], { type: "text/csv" }));
}

export async function savePicture(scene) {
  download(`tissueid-${stamp()}.png`, await scene.picture());
}
