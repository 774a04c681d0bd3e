// Searches headings and text of all pages, without a network: a page opened as a file may load a script, but not fetch.
"use strict";
const box = document.querySelector(".search");
const [input, list] = [box.querySelector("input"), box.querySelector("ol")];
const MOST = 20;

// Appends an element with this text, in which every word is marked.
function append(parent, tag, text, words) {
  const literal = words.map((word) => word.replace(/[.*+?^${}()|[\]\\]/g, "\\$&"));
  // Every second part is a word.
  const parts = text.split(new RegExp(`(${literal.join("|")})`, "i"));
  const element = parent.appendChild(document.createElement(tag));
  parts.forEach((part, i) => (i % 2 ? element.appendChild(document.createElement("mark")) : element).append(part));
}

// Shows the sections that have all words; first those that have most of them in the heading.
function show() {
  const words = input.value.toLowerCase().split(/\s+/).filter((word) => word);
  list.replaceChildren();
  list.hidden = !words.length || !window.searchIndex;
  if (list.hidden) return;
  const found = [];
  for (const [address, page, heading, text] of window.searchIndex) {
    const [above, below] = [heading.toLowerCase(), text.toLowerCase()];
    if (!words.every((word) => above.includes(word) || below.includes(word))) continue;
    const first = Math.min(...words.map((word) => below.indexOf(word)).filter((at) => at >= 0));
    const from = Number.isFinite(first) ? below.lastIndexOf(" ", Math.max(0, first - 50)) + 1 : 0;
    const rank = words.filter((word) => above.includes(word)).length;
    found.push({ address, rank, title: `${page}: ${heading}`, text: text.slice(from, from + 160) });
  }
  found.sort((a, b) => b.rank - a.rank);
  for (const { address, title, text } of found.slice(0, MOST)) {
    const link = list.appendChild(document.createElement("li")).appendChild(document.createElement("a"));
    link.href = address;
    append(link, "strong", title, words);
    append(link, "span", text, words);
  }
  const more = found.length ? `${found.length - MOST} more sections; add a word` : "No section has all these words.";
  if (!found.length || found.length > MOST) list.appendChild(document.createElement("li")).append(more);
}

// The index is larger than a page, so it is loaded at the first use.
input.addEventListener("focus", () => {
  const index = document.createElement("script");
  [index.src, index.onload] = ["search-index.js", show];
  document.head.append(index);
}, { once: true });
input.addEventListener("focus", show);
input.addEventListener("input", show);
document.addEventListener("click", (event) => {
  if (!box.contains(event.target) || event.target.closest("a")) list.hidden = true;
});
document.addEventListener("keydown", (event) => {
  const stops = [input, ...list.querySelectorAll("a")];
  const at = stops.indexOf(document.activeElement);
  const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
  if (event.key === "/" && at !== 0 && !event.ctrlKey && !event.metaKey) input.focus();
  else if (event.key === "Escape" && at >= 0) list.hidden = true;
  else if (event.key === "Enter" && at === 0 && stops[1]) stops[1].click();
  else if (step && at >= 0 && !list.hidden) stops[Math.min(Math.max(at + step, 0), stops.length - 1)].focus();
  else return;
  event.preventDefault();
});
input.hidden = false;
