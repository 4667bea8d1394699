"""What every page must be, whatever it shows: accessible, usable by keyboard, without sideways scrolling."""

from typing import Any

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

# Rules of axe that a page need not keep, and why.
EXCEPTIONS: dict[str, str] = {}

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
    """No violation of any of axe's rules, best practices included, that is not among the exceptions."""
    found = Axe().run(page)
    wrong = [each for each in found.response["violations"] if each["id"] not in EXCEPTIONS]
    assert not wrong, "\n".join(
        f"{each['id']} ({each['impact']}): {each['help']}: {[node['html'] for node in each['nodes']]}" for each in wrong
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


CUT = """() => {
  const cut = new Set();
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const letters = document.createRange();
  while (texts.nextNode()) {
    const node = texts.currentNode;
    const at = node.parentElement;
    if (!at.checkVisibility({ visibilityProperty: true })) continue;
    if (at.closest('.sr, .skip, pre, code, .mono, textarea')) continue;
    for (const { 0: word, index } of node.data.matchAll(/\\p{L}{3,}/gu)) {
      letters.setStart(node, index);
      letters.setEnd(node, index + word.length);
      if (new Set([...letters.getClientRects()].map((box) => Math.round(box.top))).size > 1) cut.add(word);
    }
  }
  return [...cut];
}"""


def no_word_is_cut(page: Page) -> None:
    """Each word stands in one line; names of keys and files may not."""
    cut = page.evaluate(CUT)
    assert not cut, f"{cut} at {page.viewport_size}"


DRAWN = "() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))"
HALF_PX = {"width": 683, "height": 384}  # what 200 % leave of 1366 x 768
# Controls that cannot be brought into sight and hit, or whose own words do not fit into them.
OUT_OF_REACH = """() => {
  document.activeElement?.blur(); // a link that is seen only while it has the focus lies over others
  const wanted = 'a[href], button, input, select, textarea, summary, [tabindex], [contenteditable=true]';
  return [...document.querySelectorAll(wanted)]
    .filter((e) => !e.disabled && e.tabIndex >= 0 && e.checkVisibility({ visibilityProperty: true }) &&
      !e.closest('[inert]') && e.type !== 'hidden' && !e.matches('.skip, .sr'))
    .filter((e) => {
      e.scrollIntoView({ block: 'center', inline: 'center', behavior: 'instant' });
      const box = e.getClientRects()[0]; // of a link in a text that is wrapped: its first line
      const [left, right] = [Math.max(0, box.left), Math.min(innerWidth, box.right)];
      const [top, bottom] = [Math.max(0, box.top), Math.min(innerHeight, box.bottom)];
      const hit = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
      const cut = e.matches('button, a') && e.scrollWidth > e.clientWidth + 1 &&
        getComputedStyle(e).overflowX !== 'visible';
      return cut || box.left < -1 || hit === null || !(e.contains(hit) || hit.closest('label')?.contains(e));
    }).map((e) => e.outerHTML.slice(0, 160));
}"""
# Of animations that run: those of anything but opacity, which moves nothing.
MOVING = """() => document.getAnimations().filter((one) => one.playState === 'running').flatMap((one) =>
  one.effect.getKeyframes().flatMap((frame) => Object.keys(frame)
    .filter((name) => !['offset', 'computedOffset', 'easing', 'composite', 'opacity'].includes(name))
    .map((name) => `${name} of ${one.effect.target?.outerHTML.slice(0, 80)}`)))"""


def usable_when_zoomed(page: Page) -> None:
    """At 200 % of a small desk nothing sticks out to the side; each control can be brought into sight and pressed."""
    before = page.viewport_size
    page.set_viewport_size(HALF_PX)  # type: ignore[arg-type]
    try:
        page.evaluate(DRAWN)
        no_sideways_scroll(page)
        out = page.evaluate(OUT_OF_REACH)
        assert not out, out
    finally:
        page.set_viewport_size(before or HALF_PX)  # type: ignore[arg-type]


def still_where_motion_is_not_wanted(page: Page) -> None:
    """Nothing moves where the viewer's system asks for reduced motion."""
    page.emulate_media(reduced_motion="reduce")
    try:
        for _ in range(10):  # what is over at once has no motion
            page.evaluate(DRAWN)
            if not (moving := page.evaluate(MOVING)):
                return
        raise AssertionError(moving)
    finally:
        page.emulate_media(reduced_motion="null")


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
