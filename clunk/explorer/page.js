// Keys and downloads of the page, and what it says when the explorer has ended.
window.addEventListener("keydown", (event) => {
  const target = event.composedPath()[0];
  const known = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "p", "u", "f", "Escape"];
  if (["INPUT", "SELECT", "TEXTAREA"].includes(target.tagName) || target.closest?.(".noUi-target")) return;
  if (!known.includes(event.key) || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  keys.data = {key: [event.key], steps: [event.shiftKey ? 10 : 1]};
});
