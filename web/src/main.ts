import "uplot/dist/uPlot.min.css";
import "./styles/base.css";
import "./styles/studies.css";
import "./styles/study.css";
import mark from "./styles/mark.svg";
import { chooseLanguage, detectLanguage, isLanguage, language, LANGUAGES, t } from "./languages/index.ts";
import { byId, h } from "./page/dom.ts";
import { follow, route } from "./page/router.ts";
import { box } from "./page/trouble.ts";
import { studiesPage } from "./studies/page.ts";

const STUDY = /^\/studies\/([0-9a-f-]{36})$/;

detectLanguage();
const content = byId("content");
const render = route(content, (path, signal) => {
  const [, id] = STUDY.exec(path) ?? [];
  if (path === "/") return titled(t("studies.title"), studiesPage(signal));
  if (id !== undefined) return titled(t("study.title", { name: id.slice(-6) }), later(id, signal));
  const back = h("a", { href: "/", class: "button", onclick: follow }, t("app.back"));
  return titled(t("trouble.notPage"), h("div", { class: "page" }, h("h1", { tabindex: -1 }, t("trouble.notPage")), box(path, [h("p", {}, t("trouble.notPage.detail", { path }))], [back])));
});
frame();

/** The list is there before all that the page of a study needs is loaded. */
function later(id: string, signal: AbortSignal): HTMLElement {
  const place = h("div", {}, h("p", { class: "page faint", role: "status" }, t("app.loading")));
  void import("./study/page.ts").then(({ studyPage }) => {
    if (!signal.aborted) place.replaceChildren(studyPage(id, signal));
  });
  return place;
}

function titled(title: string, page: HTMLElement): HTMLElement {
  document.title = `${title} – ${t("app.title")}`;
  return page;
}

/** What stands around every page, in the language in use. */
function frame(): void {
  const select = h("select", { id: "language", "aria-label": t("app.language") }, ...LANGUAGES.map(([tag, name]) => h("option", { value: tag, lang: tag, selected: tag === language() }, name)));
  select.addEventListener("change", () => {
    if (!isLanguage(select.value)) return;
    chooseLanguage(select.value);
    frame();
    render();
    byId("language").focus();
  });
  byId("header").replaceChildren(
    h("a", { class: "skip", href: "#content" }, t("app.skip")),
    h("a", { class: "brand", href: "/", onclick: follow }, h("img", { src: mark, alt: "", width: 26, height: 26 }), h("span", {}, t("app.title")), h("span", { class: "tagline" }, t("app.tagline"))),
    h("span", { class: "spring" }),
    select,
  );
  byId("footer").replaceChildren(h("span", {}, t("app.research")), h("a", { href: "/docs" }, t("app.reference")));
}
