(function () {
  "use strict";
  // What is read only when it comes near joins at the trial and the moment that the others show.
  const last = { "sysid-view": null, "sysid-time": null };
  for (const name in last) document.addEventListener(name, (event) => { last[name] = event.detail; });
  document.addEventListener("sysid-join", function () {
    for (const [name, detail] of Object.entries(last)) if (detail) document.dispatchEvent(new CustomEvent(name, { detail }));
  });
  addEventListener("beforeprint", function () {
    for (const part of document.querySelectorAll("details:not([open]):not(.unprinted)")) { part.open = true; part.dataset.printed = "1"; }
  });
  addEventListener("afterprint", function () {
    for (const part of document.querySelectorAll("details[data-printed]")) { part.open = false; delete part.dataset.printed; }
  });
})();
