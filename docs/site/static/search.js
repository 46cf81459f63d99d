/* The search of the site: ranks the entries of search_entries.js, and writes the results with excerpts. */
"use strict";

/** The words of a text or name: joint_wrench, StepControl and "warm starts" are two words each, plurals are singular. */
function words(text) {
  return text
    .replace(/([a-z0-9])([A-Z])/g, "$1 $2")
    .toLowerCase()
    .split(/[^\p{L}\p{N}]+/u)
    .filter(Boolean)
    .map(singular);
}

function singular(word) {
  if (word.length < 4 || /(ss|us|is|s's)$/.test(word)) return word;
  if (/ies$/.test(word)) return word.slice(0, -3) + "y";
  if (/(ch|sh|x|ss)es$/.test(word)) return word.slice(0, -2);
  return word.replace(/s$/, "");
}

const common = new Set("a an and are as at be by for from how i in is it my of on or the to what with".split(" "));
const joined = (text) => words(text).join("");
/** What results of a kind get beside their words: a name before a page, a page before a section. */
const bonus = { name: 40, page: 30, section: 20, member: 10 };

/** How well a word of the query fits a list of words: 1 whole, less for a beginning. */
function fit(word, list) {
  let best = 0;
  for (const other of list) {
    if (other === word) return 1;
    if (word.length > 2 && other.startsWith(word)) best = Math.max(best, 0.6);
    // "refinement" of the query finds "refine".
    else if (other.length > 4 && word.startsWith(other)) best = Math.max(best, 0.4);
  }
  return best;
}

/** Each entry once with its words; kept, for a reader types more than one query. */
function prepare(entries) {
  const frequency = new Map();
  const prepared = entries.map(([kind, title, context, address, text]) => {
    const name = kind === "name" ? title.split(".").pop() : kind === "member" ? title.split(".").slice(-2).join(".") : title;
    const counts = new Map();
    for (const word of words(text)) counts.set(word, (counts.get(word) || 0) + 1);
    for (const word of counts.keys()) frequency.set(word, (frequency.get(word) || 0) + 1);
    const last = title.split(".").pop();
    return {
      kind, title, context, address, text, counts, last,
      joined: [joined(name), joined(kind === "section" || kind === "page" ? title : last), joined(title)],
      title_words: words(name), path_words: words(`${title} ${context}`),
    };
  });
  return { prepared, frequency };
}

/** The entries that have every word of a query, best first. */
function rank(query, index) {
  const all = words(query);
  const asked = all.filter((word) => !common.has(word)).length ? all.filter((word) => !common.has(word)) : all;
  if (!asked.length) return [];
  const whole = all.join("");
  const literal = query.trim().replace(/^tx\./, "").replace(/\(\)$/, "");
  const rare = (word) => Math.log(1 + index.prepared.length / (1 + (index.frequency.get(word) || 0)));
  const results = [];
  for (const entry of index.prepared) {
    let score = 0;
    let missing = 0;
    let titled = 0;
    for (const word of asked) {
      const inTitle = fit(word, entry.title_words);
      const inPath = 0.3 * fit(word, entry.path_words);
      const count = entry.counts.get(word) || 0;
      if (!(inTitle || inPath || count)) missing += 1;
      titled += inTitle;
      score += rare(word) * (10 * inTitle + 5 * inPath + (3 * count) / (count + 2));
    }
    if (missing) continue;
    const share = titled / asked.length;
    // The more of the title the query is, the better.
    score += 60 * share * Math.min(1, asked.length / entry.title_words.length);
    if (share === 1) score += 30;
    if (share > 0.5) score += bonus[entry.kind];
    // The whole name or heading: first, and a class before its methods.
    if (entry.kind !== "member" && entry.joined.slice(0, 2).includes(whole)) score += 1000;
    else if (entry.joined.includes(whole)) score += 600;
    if (entry.last === literal || entry.title.endsWith(`.${literal}`)) score += literal.includes(".") ? 1500 : 5;
    results.push([score, entry]);
  }
  results.sort((a, b) => b[0] - a[0] || a[1].title.length - b[1].title.length || (a[1].title < b[1].title ? -1 : 1));
  return results.map(([, entry]) => entry);
}

/** Some of the text about the first word that it has of the query, in pieces: [text, whether it is of the query]. */
function excerpt(query, text, length = 220) {
  const asked = words(query).filter((word) => !common.has(word));
  const pieces = text.split(/([\p{L}\p{N}]+)/u);
  const marked = pieces.map((piece, i) => i % 2 === 1 && words(piece).some((word) => asked.includes(word)));
  const first = Math.max(0, marked.indexOf(true));
  let begin = first;
  for (let before = 0; begin > 0 && before < length / 3; ) before += pieces[--begin].length;
  const shown = begin ? [["… ", false]] : [];
  let count = 0;
  let i = begin;
  for (; i < pieces.length && count < length; i++) {
    shown.push([pieces[i], marked[i]]);
    count += pieces[i].length;
  }
  return i < pieces.length ? [...shown, [" …", false]] : shown;
}

function show(query, list, entries) {
  const found = rank(query, prepare(entries));
  const heading = document.createElement("h1");
  heading.textContent = query ? `${found.length} results for “${query}”` : "Search";
  list.before(heading);
  for (const entry of found.slice(0, 60)) {
    const item = list.appendChild(document.createElement("li"));
    const link = item.appendChild(document.createElement("a"));
    link.href = entry.address;
    link.textContent = entry.title;
    if (entry.kind === "name" || entry.kind === "member") link.className = "name";
    if (entry.context !== entry.title) item.append(` — ${entry.context}`);
    const summary = item.appendChild(document.createElement("p"));
    for (const [text, marked] of excerpt(query, entry.text)) {
      summary.appendChild(document.createElement(marked ? "mark" : "span")).textContent = text;
    }
  }
}

if (typeof document !== "undefined") {
  const query = new URLSearchParams(window.location.search).get("q") || "";
  document.querySelectorAll('input[name="q"]').forEach((field) => (field.value = query));
  show(query, document.getElementById("results"), searchEntries);
} else {
  module.exports = { prepare, rank, excerpt };
}
