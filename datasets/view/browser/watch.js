// Loads the page again when it has been written anew: `scenec view --watch`.

const WATCH_MS = 1500;

/** Asks the script beside the page which state that is of; where it is gone, nobody watches. */
function watchPage(state, name) {
  const script = make("script", { src: `${encodeURIComponent(name)}?${Date.now()}` });
  script.addEventListener("error", () => script.remove());
  script.addEventListener("load", () => {
    script.remove();
    if (window.scenecState !== state) location.reload();
    else setTimeout(() => watchPage(state, name), WATCH_MS);
  });
  document.head.append(script);
}

function startWatch() {
  if (!index.watched) return;
  const name = decodeURIComponent(location.pathname.split("/").pop());
  setTimeout(() => watchPage(index.watched, `${name}.watch.js`), WATCH_MS);
}
