// Examines the pages of the book in frames. Writes one line per fault, then the number of pages.
//
// `pages`: names of the pages. `files`: names of all files of the book. `widths`: pixels.
function examine(pages, files, widths) {
  const faults = [];
  const frames = [...document.querySelectorAll("iframe")];
  const documents = new Map(frames.map((frame) => [frame.dataset.page, frame.contentDocument]));
  const root = new URL("book/", location.href).href;

  // Returns whether an ancestor of `element` scrolls or hides what is too wide.
  function contained(element) {
    for (let above = element.parentElement; above && above.tagName !== "MAIN"; above = above.parentElement) {
      if (getComputedStyle(above).overflowX !== "visible") return true;
    }
    return false;
  }

  function checkWidth(name, width, main) {
    for (const element of main.querySelectorAll("*")) {
      const { left, right } = element.getBoundingClientRect();
      if ((right > width + 0.5 || left < -0.5) && !contained(element)) {
        const text = element.textContent.trim().slice(0, 60);
        faults.push(`${name} at ${width} px: ${element.tagName} from ${left} to ${right} px: ${text}`);
      }
    }
  }

  function checkLink(name, link) {
    const url = new URL(link.href);
    const anchor = decodeURIComponent(url.hash.slice(1));
    url.hash = "";
    if (url.protocol.startsWith("http")) return;
    const file = decodeURIComponent(url.href.slice(root.length));
    const lacks = !url.href.startsWith(root) || !files.includes(file);
    if (lacks || (anchor && !documents.get(file)?.getElementById(anchor))) {
      faults.push(`${name}: broken link ${link.getAttribute("href")}`);
    }
  }

  let examined = 0;
  for (const frame of frames) {
    const { page } = frame.dataset;
    const main = frame.contentDocument.querySelector("main");
    if (!main || main.textContent.trim().length < 100) {
      faults.push(`${page}: no content`);
      continue;
    }
    checkWidth(page, frame.clientWidth, main);
    for (const link of frame.contentDocument.querySelectorAll("a[href]")) checkLink(page, link);
    for (const image of main.querySelectorAll("img")) {
      if (image.naturalWidth === 0) faults.push(`${page}: no image ${image.getAttribute("src")}`);
    }
    examined += 1;
  }
  const lines = [...new Set(faults), `examined ${examined} of ${pages.length * widths.length}`];
  document.body.textContent = lines.join("\n");
}
