"""What every page must be, whatever it shows: accessible, usable by keyboard, without sideways scrolling."""

from typing import Any

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

GRAVE = ("serious", "critical")

# What a person can use: visible, not disabled, and not taken out of the tab order on purpose (whatever is, must be
# reachable with arrow keys: one radio button of a group, one tab of a row).
USABLE = """() => {
  const wanted = 'a[href], button, input, select, textarea, summary, [tabindex], [contenteditable=true]';
  const label = (e) => {
    const path = [];
    for (let at = e; at && at !== document.body; at = at.parentElement) {
      path.unshift(at.tagName.toLowerCase() + (at.id ? '#' + at.id : '') +
        ':' + [...(at.parentElement?.children ?? [])].indexOf(at));
    }
    return path.join('>');
  };
  window.__label = label;
  return [...document.querySelectorAll(wanted)]
    .filter((e) => !e.disabled && e.tabIndex >= 0 && e.checkVisibility({ visibilityProperty: true }) &&
      !e.closest('[inert]') && e.type !== 'hidden' &&
      !(e.type === 'radio' && !e.checked && document.querySelector(`input[name="${e.name}"]:checked`)))
    .map(label);
}"""
FOCUSED = """() => {
  const e = document.activeElement;
  if (!e || e === document.body || e === document.documentElement) return null;
  const looks = () => {
    const s = getComputedStyle(e);
    return [s.outlineStyle === 'none' ? 0 : parseFloat(s.outlineWidth), s.boxShadow, s.borderColor, s.backgroundColor];
  };
  const with_focus = looks();
  return { label: window.__label(e), outline_px: with_focus[0], shadow: with_focus[1],
           text: (e.getAttribute('aria-label') ?? e.textContent ?? '').trim().slice(0, 40), tab_index: e.tabIndex };
}"""


def accessible(page: Page) -> None:
    """No violation that axe calls serious or critical."""
    found = Axe().run(page)
    grave = [each for each in found.response["violations"] if each["impact"] in GRAVE]
    assert not grave, "\n".join(
        f"{each['id']} ({each['impact']}): {each['help']}: {[node['html'] for node in each['nodes']]}" for each in grave
    )
    assert found.response["passes"], "axe looked at nothing"


def no_sideways_scroll(page: Page) -> None:
    """Nothing sticks out of the window to the right: neither the page nor an element that would be cut off."""
    wide: dict[str, Any] = page.evaluate("""() => ({
      page_px: document.documentElement.scrollWidth,
      window_px: document.documentElement.clientWidth,
      out: [...document.body.querySelectorAll('*')]
        .filter((e) => e.getBoundingClientRect().right > document.documentElement.clientWidth + 1)
        .map((e) => e.outerHTML.slice(0, 120)).slice(0, 3),
    })""")
    assert wide["page_px"] <= wide["window_px"], wide


def usable_by_keyboard(page: Page) -> list[str]:
    """Tab alone goes through everything that can be used, once round, and always shows where it is.

    Returns the labels in order, the way they are read to a blind person.
    """
    usable = page.evaluate(USABLE)
    assert usable, "nothing on this page can be used"
    reached: list[dict[str, Any]] = []
    for _ in range(2 * len(usable) + 4):  # from wherever the focus is, once round and through the browser's own frame
        page.keyboard.press("Tab")
        at = page.evaluate(FOCUSED)
        if at is not None and reached and at["label"] == reached[0]["label"]:
            break
        reached += [at] if at is not None else []
    assert reached, "Tab leads nowhere"
    missed = set(usable) - {each["label"] for each in reached}
    assert not missed, f"not reached by Tab: {missed}"
    unseen = [each for each in reached if each["outline_px"] < 1 and each["shadow"] == "none"]
    assert not unseen, f"nothing shows that these have the focus: {unseen}"
    ahead = [each for each in reached if each["tab_index"] > 0]
    assert not ahead, f"a tab order of their own: {ahead}"
    return [each["text"] for each in reached]
