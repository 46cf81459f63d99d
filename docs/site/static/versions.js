/* The selector of versions. Beside a site of one version may stand others: ../versions.js lists them (versions.py writes
   it). A page opened from a file may load a script and fetch nothing. Without the list the present version stays alone. */
"use strict";

/** The options of the selector, newest first: the same page of another version where it has it, else its first page. */
function choices(listed, present, root, page) {
  const entries = listed.some((entry) => entry.version === present) ? listed : [{ version: present }, ...listed];
  return entries.map(({ version, pages = [] }) => {
    const name = pages.includes(page) ? page : "index";
    const selected = version === present;
    return { version, selected, address: selected ? "" : `${root}../${encodeURIComponent(version)}/${name}.html` };
  });
}

/** Fill the selector of a page when the list is there. */
function connect(place) {
  const select = place.querySelector("select");
  const { root, page, version } = place.dataset;
  const list = document.createElement("script");
  list.src = `${root}../versions.js`;
  list.onload = () => {
    const options = choices(window.twistaxVersions || [], version, root, page);
    select.replaceChildren(...options.map((option) => new Option(option.version, option.address, false, option.selected)));
    select.addEventListener("change", () => select.value && window.location.assign(select.value));
  };
  document.head.append(list);
}

if (typeof module === "object") module.exports = { choices };
else document.querySelectorAll(".versions").forEach(connect);
