"use strict";
// The viewer: shows the picture that the address names (#overlay-2), zooms with the wheel, moves by dragging.
(() => {
  const viewer = document.getElementById("viewer");
  const image = viewer.querySelector("img");
  const caption = viewer.querySelector("p");
  const links = [...document.querySelectorAll("a.zoom")];
  let scale = 1, left = 0, top = 0, grip = null;

  const place = () => { image.style.transform = `translate(${left}px, ${top}px) scale(${scale})`; };

  const fit = () => {
    scale = Math.min(innerWidth / image.naturalWidth, innerHeight / image.naturalHeight);
    left = (innerWidth - scale * image.naturalWidth) / 2;
    top = (innerHeight - scale * image.naturalHeight) / 2;
    place();
  };

  const zoom = (factor, x, y) => {
    const limited = Math.min(Math.max(scale * factor, 0.05), 60) / scale;
    left = x - limited * (x - left);
    top = y - limited * (y - top);
    scale *= limited;
    image.style.imageRendering = scale > 3 ? "pixelated" : "auto";
    place();
  };

  const show = () => {
    const link = links.find((candidate) => "#" + candidate.id === location.hash);
    if (!link) { if (viewer.open) viewer.close(); return; }
    const source = link.querySelector("img");
    image.onload = fit;
    image.src = source.src;
    caption.textContent = source.alt;
    if (!viewer.open) viewer.showModal();
  };

  const step = (by) => {
    const now = links.findIndex((candidate) => "#" + candidate.id === location.hash);
    location.hash = links[(now + by + links.length) % links.length].id;
  };

  addEventListener("hashchange", show);
  viewer.addEventListener("close", () => history.replaceState(null, "", location.pathname + location.search));
  viewer.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 400), event.clientX, event.clientY);
  }, { passive: false });
  viewer.addEventListener("pointerdown", (event) => {
    if (event.target !== image) { viewer.close(); return; }
    event.preventDefault();
    grip = [event.clientX - left, event.clientY - top];
    image.setPointerCapture(event.pointerId);
  });
  viewer.addEventListener("pointermove", (event) => {
    if (!grip) return;
    [left, top] = [event.clientX - grip[0], event.clientY - grip[1]];
    place();
  });
  viewer.addEventListener("pointerup", () => { grip = null; });
  viewer.addEventListener("dblclick", fit);
  viewer.addEventListener("keydown", (event) => {
    const actions = {
      ArrowRight: () => step(1),
      ArrowLeft: () => step(-1),
      "+": () => zoom(1.5, innerWidth / 2, innerHeight / 2),
      "-": () => zoom(1 / 1.5, innerWidth / 2, innerHeight / 2),
      0: fit,
    };
    if (event.key in actions) { event.preventDefault(); actions[event.key](); }
  });
  addEventListener("resize", () => { if (viewer.open) fit(); });
  show();
})();
