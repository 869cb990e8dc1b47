// Zoom and pan of the drawings: buttons, Ctrl + wheel, dragging. Only the view box changes, so that lines stay sharp.
document.querySelectorAll(".plot").forEach((plot) => {
  const svg = plot.querySelector("svg");
  const whole = svg.getAttribute("viewBox").split(/[ ,]+/).map(Number);
  let view = [...whole], held = null;
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
  const show = () => {
    for (const k of [0, 1]) view[k] = clamp(view[k], whole[k], whole[k] + whole[k + 2] - view[k + 2]);
    svg.setAttribute("viewBox", view.join(" "));
    plot.classList.toggle("zoomed", view[2] < whole[2]);
  };
  const zoom = (factor, x = 0.5, y = 0.5) => {
    const share = clamp((view[2] / whole[2]) * factor, 1 / 40, 1);
    const size = [whole[2] * share, whole[3] * share];
    view = [view[0] + x * (view[2] - size[0]), view[1] + y * (view[3] - size[1]), ...size];
    show();
  };
  const place = (event) => {
    const box = svg.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  };
  plot.querySelectorAll("button").forEach((button) =>
    button.addEventListener("click", () => zoom(Number(button.dataset.factor))));
  svg.addEventListener("dblclick", (event) => zoom(event.shiftKey ? 2 : 0.5, ...place(event)));
  svg.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    zoom(event.deltaY > 0 ? 1.25 : 0.8, ...place(event));
  }, { passive: false });
  svg.addEventListener("pointerdown", (event) => {
    if (view[2] >= whole[2]) return;
    held = place(event);
    svg.setPointerCapture(event.pointerId);
  });
  svg.addEventListener("pointermove", (event) => {
    if (held === null) return;
    const at = place(event);
    view[0] += (held[0] - at[0]) * view[2];
    view[1] += (held[1] - at[1]) * view[3];
    held = at;
    show();
  });
  for (const end of ["pointerup", "pointercancel"]) svg.addEventListener(end, () => { held = null; });
});
