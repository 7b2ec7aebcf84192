"use strict";
(function () {
  const root = document.documentElement;
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  let chosen = null;
  function theme() {
    root.dataset.theme = chosen || (dark.matches ? "dark" : "light");
    document.querySelectorAll("button.theme").forEach((button) => {
      button.textContent = root.dataset.theme === "dark" ? "Light page" : "Dark page";
    });
  }
  theme();
  document.querySelectorAll("button.theme").forEach((button) => {
    button.addEventListener("click", () => {
      chosen = root.dataset.theme === "dark" ? "light" : "dark";
      theme();
    });
  });
  dark.addEventListener("change", theme);
  const folded = [];
  window.addEventListener("beforeprint", () => {
    document.querySelectorAll("details:not([open])").forEach((d) => { d.open = true; folded.push(d); });
    root.dataset.theme = "light";
  });
  window.addEventListener("afterprint", () => {
    folded.splice(0).forEach((d) => { d.open = false; });
    theme();
  });
})();
