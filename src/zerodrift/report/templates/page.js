"use strict";
(function () {
  const root = document.documentElement;
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  let chosen = null;
  const plots = Array.from(document.querySelectorAll("figure .plot"));
  const inkNow = () => getComputedStyle(root).getPropertyValue("--plot-ink").trim();
  function theme() {
    root.dataset.theme = chosen || (dark.matches ? "dark" : "light");
    document.querySelectorAll("button.theme").forEach((button) => {
      button.textContent = root.dataset.theme === "dark" ? "Light page" : "Dark page";
    });
  }
  function recolour() {
    plots.forEach((div) => Plotly.relayout(div, { "font.color": inkNow() }));
  }
  theme();
  plots.forEach((div) => {
    const figure = JSON.parse(div.parentElement.querySelector("script").textContent);
    figure.layout.font.color = inkNow();
    Plotly.newPlot(div, figure.data, figure.layout, { displaylogo: false, responsive: true });
  });
  document.querySelectorAll("button.theme").forEach((button) => {
    button.addEventListener("click", () => {
      chosen = root.dataset.theme === "dark" ? "light" : "dark";
      theme();
      recolour();
    });
  });
  dark.addEventListener("change", () => { theme(); recolour(); });
  const folded = [];
  window.addEventListener("beforeprint", () => {
    document.querySelectorAll("details:not([open])").forEach((d) => { d.open = true; folded.push(d); });
    root.dataset.theme = "light";
    plots.forEach((div) => Plotly.relayout(div, { width: 670, "font.color": "#3c4650" }));
  });
  window.addEventListener("afterprint", () => {
    folded.splice(0).forEach((d) => { d.open = false; });
    theme();
    plots.forEach((div) => Plotly.relayout(div, { width: null, autosize: true, "font.color": inkNow() }));
  });
})();
