// What the theme leaves out for people who use a keyboard or a screen reader.
document.addEventListener("DOMContentLoaded", () => {
  // A table or a block of code that scrolls sideways can be reached and scrolled by keyboard.
  const scrolled = () => {
    for (const element of document.querySelectorAll("pre, .table-wrapper, article table, div.math")) {
      if (element.scrollWidth > element.clientWidth + 1) element.tabIndex = 0;
    }
  };
  scrolled();
  window.addEventListener("resize", scrolled);
  // Both sidebars have a name.
  document.querySelector("aside.sidebar-drawer")?.setAttribute("aria-label", "Pages");
  document.querySelector("aside.toc-drawer")?.setAttribute("aria-label", "Contents of this page");
  for (const [index, tools] of document.querySelectorAll(".content-icon-container").entries()) {
    tools.setAttribute("role", "navigation");
    tools.setAttribute("aria-label", `Tools of this page ${index + 1}`);
  }
  // The page of the search has no heading of its own.
  if (!document.querySelector("h1")) {
    const heading = document.createElement("h1");
    heading.textContent = "Search";
    document.querySelector("article, #furo-main-content")?.prepend(heading);
  }
});
