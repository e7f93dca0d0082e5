"use strict";
// What is decided on the page goes to its server, which writes study.toml; then the page is loaded again.
(() => {
  const armed = new Map();
  document.addEventListener("focusin", (event) => {
    const form = event.target.closest("form.correct");
    if (form && event.target.name === "value") armed.set(form.dataset.recording, form);
  });
  // a click into a picture sets the field that was entered last, else the contact
  document.addEventListener("pick", (event) => {
    const { recording, t, x } = event.detail;
    const form = armed.get(recording) || document.querySelector(`form.correct[data-recording="${recording}"][data-key="contact_mm"]`);
    if (!form) return;
    event.preventDefault();
    form.elements.value.value = Number((form.dataset.key === "contact_mm" ? x : t).toPrecision(7));
    form.elements.because.focus();
  });
  const send = async (form, value) => {
    const said = form.querySelector("output");
    const buttons = [...form.querySelectorAll("button")];
    buttons.forEach((button) => { button.disabled = true; });
    said.textContent = "writing";
    const words = { path: form.dataset.path, sheet: form.dataset.sheet ?? null, key: form.dataset.key, value, because: form.elements.because.value };
    try {
      const answer = await fetch(`decide${location.search}`, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(words) });
      const told = await answer.json();
      said.textContent = told.said;
      if (answer.ok) {
        sessionStorage.setItem("told", JSON.stringify({ ...told, recording: form.dataset.recording, key: form.dataset.key }));
        history.replaceState(null, "", `#${form.dataset.recording}`);
        location.reload();
        return;
      }
    } catch {
      said.textContent = "the server does not answer: is tissueid inspect --serve still running?";
    }
    buttons.forEach((button) => { button.disabled = false; });
  };
  document.addEventListener("submit", (event) => {
    const form = event.target.closest("form.correct");
    if (!form) return;
    event.preventDefault();
    const found = form.elements.value ? Number(form.elements.value.value) : true;
    send(form, event.submitter?.matches("[data-back]") ? null : found);
  });
  const told = JSON.parse(sessionStorage.getItem("told") || "null");
  sessionStorage.removeItem("told");
  const form = told && document.querySelector(`form.correct[data-recording="${told.recording}"][data-key="${told.key}"]`);
  if (form) form.querySelector("output").textContent = told.said;
})();
