// What the theme makes while a page loads can be reached by keyboard, and has a name for screen readers.
const name = () => {
  for (const each of document.querySelectorAll("pre > code, .md-typeset__scrollwrap")) each.tabIndex = 0
  document.querySelectorAll(".md-code__nav").forEach((each, number) => each.ariaLabel = `Code block ${number + 1}`)
}
addEventListener("DOMContentLoaded", () => {
  name()
  new MutationObserver(name).observe(document.querySelector("main"), { childList: true, subtree: true })
})
