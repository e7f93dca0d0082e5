// Light or dark: as the system says, until somebody chooses; and what parts of the page are found by.

const KEY = "tissueid-theme";
const asked = window.matchMedia("(prefers-color-scheme: dark)");

/** What is done with what a browser keeps; null where it keeps nothing. */
function kept(doing) {
  try {
    return doing(localStorage);
  } catch {
    return null;
  }
}

let chosen = kept((store) => store.getItem(KEY));

function isDark() {
  return chosen === null ? asked.matches : chosen === "dark";
}

export function startTheme(changed) {
  const apply = () => {
    document.documentElement.dataset.theme = isDark() ? "dark" : "light";
    changed();
  };
  asked.addEventListener("change", apply);
  apply();
  return () => {
    chosen = isDark() ? "light" : "dark";
    kept((store) => store.setItem(KEY, chosen));
    apply();
  };
}

/** An element of the page. */
export const byId = (id) => document.getElementById(id);

/** A colour of the style sheet. */
export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}
