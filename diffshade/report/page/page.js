"use strict";
// The wipes: how much of a photograph its fit covers.
for (const slider of document.querySelectorAll(".wipe input")) {
  const show = () => slider.parentElement.style.setProperty("--at", `${slider.value}%`);
  slider.addEventListener("input", show);
  show();
}
