"use strict";
for (const article of document.querySelectorAll("article")) {
  const slider = article.querySelector("input[type=range]");
  if (!slider) continue;
  const frames = [...article.querySelectorAll(".film img")];
  const show = () => {
    const at = Number(slider.value);
    const shown = frames.filter((frame) => Number(frame.dataset.at) <= at).at(-1) ?? frames[0];
    for (const frame of frames) frame.hidden = frame !== shown;
    for (const line of article.querySelectorAll(".now")) {
      const x = (1000 * at) / Number(slider.max);
      line.setAttribute("x1", x);
      line.setAttribute("x2", x);
    }
    article.querySelector("output").textContent = `${at.toFixed(1)} s`;
  };
  slider.addEventListener("input", show);
  show();
}
