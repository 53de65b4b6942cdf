// Before the first paint, so that a dark hall is never lit up by a white page.
(() => {
  const chosen = localStorage.getItem("handover.theme");
  if (chosen === "light" || chosen === "dark") document.documentElement.dataset.theme = chosen;
})();
