// Light or dark: as the system says, until somebody chooses.

const KEY = "tissueid-theme";
const asked = window.matchMedia("(prefers-color-scheme: dark)");

function stored() {
  try {
    return localStorage.getItem(KEY);
  } catch {
    return null; // a browser that keeps nothing
  }
}

let chosen = stored();

export function isDark() {
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
    try {
      localStorage.setItem(KEY, chosen);
    } catch {
      // chosen for this page only
    }
    apply();
  };
}

/** A colour of the style sheet. */
export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}
