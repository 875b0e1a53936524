(function () {
  "use strict";
  addEventListener("beforeprint", function () {
    for (const part of document.querySelectorAll("details:not([open]):not(.unprinted)")) { part.open = true; part.dataset.printed = "1"; }
  });
  addEventListener("afterprint", function () {
    for (const part of document.querySelectorAll("details[data-printed]")) { part.open = false; delete part.dataset.printed; }
  });
})();
