// What all parts use. Everything is built with textContent and attributes: names are never read
// as HTML. The files of the page's script stand in one function, one after the other.

const $ = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const PAGE = 100;

function make(tag, properties = {}, ...children) {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(properties)) {
    if (key === "class") node.className = value;
    else if (key.includes("-") || key === "role") node.setAttribute(key, value);
    else node[key] = value;
  }
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

function read(id) {
  const node = $(id);
  return node ? JSON.parse(node.textContent) : null;
}

function comparator(sign) {
  // What has no number comes last, whichever way it is sorted.
  return ([a], [b]) => {
    const emptyA = a === null || a === "–", emptyB = b === null || b === "–";
    if (emptyA || emptyB) return emptyA - emptyB;
    if (typeof a === "number" && typeof b === "number") return sign * (a - b);
    if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1;
    return sign * a.localeCompare(b, undefined, { numeric: true });
  };
}

function nextOrder(th, isNumber) {
  const before = th.getAttribute("aria-sort");
  const first = isNumber ? "descending" : "ascending";
  const other = isNumber ? "ascending" : "descending";
  return before === first ? other : first;
}

function markSorted(th, order) {
  for (const head of th.parentElement.children) head.setAttribute("aria-sort", "none");
  th.setAttribute("aria-sort", order);
}
