"use strict";
// Figures whose traces stand in the page; what names an `ink` is of that colour of the page, or a `faint` one is it.
(() => {
  const inked = (node) => {
    if (Array.isArray(node)) return node.map(inked);
    if (node === null || typeof node !== "object") return node;
    if ("faint" in node) return faint(node.ink, node.faint);
    const { ink, ...rest } = Object.fromEntries(Object.entries(node).map(([key, value]) => [key, inked(value)]));
    return ink ? { ...rest, color: colour(ink) } : rest;
  };
  figureBoxes((box) => inked(payload[Number(box.dataset.place ?? box.dataset.figure)]));
})();
