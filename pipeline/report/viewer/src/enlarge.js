// Pictures of the page fill the window when they are clicked, until the next click. A script of its own on pages that play
// nothing, and a part of the viewer on the others.
document.addEventListener("click", ({ target }) => {
  if (target instanceof HTMLImageElement && target.closest("figure, .grid")) target.classList.toggle("large");
});
