"""How an HTML report looks on a screen, a phone and paper, and the one script in it, which enlarges its pictures."""

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; color: #222;
  background: #FFF; overflow-wrap: break-word }
h1, h2 { line-height: 1.2 } figure { margin: 1.5rem 0 } img { max-width: 100%; height: auto }
figcaption { color: #555; font-size: 90% } summary { cursor: pointer; color: #0072B2 }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums }
th, td { padding: .2rem .6rem; text-align: right; border-bottom: 1px solid #E3E3E3; vertical-align: top }
thead th { vertical-align: bottom } tbody th { font-weight: normal }
tbody td, tbody th { white-space: nowrap }
tbody .long { white-space: normal; overflow-wrap: anywhere; min-width: 14rem }
th:first-child, td:first-child { text-align: left }
pre { background: #F6F6F6; padding: .8rem; overflow-x: auto; font-size: 12px }
.scrolls { overflow-x: auto; margin: 1rem 0 }
.enlarge { display: block; padding: 0; border: 0; background: none; cursor: zoom-in }
dialog { width: 100vw; height: 100vh; max-width: none; max-height: none; padding: 0; border: 0; box-sizing: border-box }
dialog[open] { display: flex; flex-direction: column } dialog div { overflow: auto; cursor: zoom-out }
dialog img { width: 100%; min-width: 60rem; max-width: none; display: block }
dialog button { font: inherit; align-self: end; margin: .4rem; padding: .2rem .8rem }
@media (max-width: 40rem) { body { margin: 1rem auto; padding: 0 .8rem } h1 { font-size: 1.4rem } }
@media print {
  body { font-size: 10pt; max-width: none; margin: 0 } h2 { break-after: avoid } figure, tr { break-inside: avoid }
  .scrolls, pre { overflow: visible } tbody td, tbody th, pre { white-space: pre-wrap }
  table { font-size: 8pt } th, td { padding: .1rem .3rem } tbody .long { min-width: 0 }
  details:not([open]) { display: none }
}
"""

SCRIPT = """
const dialog = document.createElement("dialog"), pane = document.createElement("div");
const close = document.createElement("button");
close.textContent = "Close";
pane.tabIndex = 0;  // scrolled with the arrow keys
dialog.ariaLabel = "Figure, enlarged";
dialog.append(close, pane);
dialog.addEventListener("click", () => dialog.close());  // Esc closes it too, and focus returns to the picture
document.body.append(dialog);
for (const image of document.querySelectorAll("figure img")) {
  const button = document.createElement("button");
  button.className = "enlarge";
  button.ariaLabel = "Enlarge: " + image.alt;
  image.replaceWith(button);
  button.append(image);
  button.addEventListener("click", () => {
    pane.replaceChildren(image.cloneNode());
    dialog.showModal();
  });
}
"""
