// What the whole page does: the theme, tables that sort, stills that wait in their folds, and the viewers.

/** Lets the reader choose a theme; without a choice it is the system's. */
function startTheme() {
  const select = document.getElementById("theme");
  const apply = (theme) => {
    if (theme === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = theme;
  };
  // Some browsers keep nothing for pages from disk.
  const kept = attempt(() => localStorage.getItem("udc-theme"));
  if ([...select.options].some((option) => option.value === kept)) select.value = kept;
  apply(select.value);
  select.addEventListener("change", () => {
    apply(select.value);
    attempt(() => localStorage.setItem("udc-theme", select.value));
  });
}

function attempt(action) {
  try {
    return action();
  } catch {
    return null;
  }
}

/** The number that a cell begins with, infinite ones included; none for text. */
function numberOf(text) {
  const trimmed = text.trim().replace("−", "-");
  if (/^-?∞/.test(trimmed)) return trimmed.startsWith("-") ? -Infinity : Infinity;
  return /^-?\d/.test(trimmed) ? Number.parseFloat(trimmed) : null;
}

/** Orders numbers before text, each among themselves; what is missing is last. */
function compareCells(a, b) {
  const [x, y] = [numberOf(a), numberOf(b)];
  if (x !== null && y !== null) return x === y ? 0 : x - y;
  if (x === null && y === null) return a.localeCompare(b, "en", { numeric: true });
  return x === null ? 1 : -1;
}

/** Gives each heading of a table a button: first rising, then falling, then as it was. */
function makeSortable(table) {
  const body = table.tBodies[0];
  if (!body || body.rows.length < 2) return;
  const original = [...body.rows];
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...heading.childNodes);
    heading.append(button);
    button.addEventListener("click", () => {
      const next = { none: "ascending", ascending: "descending", descending: "none" };
      const order = next[heading.getAttribute("aria-sort") || "none"];
      headings.forEach((other) => other.removeAttribute("aria-sort"));
      const rows = [...original];
      if (order !== "none") {
        heading.setAttribute("aria-sort", order);
        const sign = order === "ascending" ? 1 : -1;
        const text = (row) => row.cells[column].textContent;
        const isMissing = (row) => text(row).trim() === "–";
        rows.sort((a, b) => isMissing(a) - isMissing(b) || sign * compareCells(text(a), text(b)));
      }
      body.append(...rows);
    });
  });
}

/** Folds are open without scripts and on paper. */
function startFolds() {
  const folds = [...document.querySelectorAll("details.fold")];
  const set = (isOpen) => folds.forEach((fold) => { fold.open = isOpen; });
  set(false);
  window.addEventListener("beforeprint", () => set(true));
  window.addEventListener("afterprint", () => set(false));
}

/** Starts each viewer as it comes near to what is seen. */
function startViewers() {
  const observer = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      if (!isIntersecting) continue;
      observer.unobserve(target);
      new Viewer(target);
    }
  }, { rootMargin: "400px" });
  document.querySelectorAll(".viewer").forEach((element) => observer.observe(element));
}

// What works by this script alone is hidden without it.
document.documentElement.classList.add("scripted");
startTheme();
startFolds();
document.querySelectorAll("table").forEach(makeSortable);
startViewers();
document.getElementById("print").addEventListener("click", () => window.print());
