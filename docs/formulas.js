// Formulas by KaTeX, which is kept here: nothing is fetched from elsewhere.
for (const place of document.querySelectorAll(".arithmatex")) {
  const text = place.textContent.trim().slice(2, -2);
  katex.render(text, place, { displayMode: place.tagName === "DIV", throwOnError: false });
}
