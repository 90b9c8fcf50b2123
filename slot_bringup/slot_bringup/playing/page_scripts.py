"""Scripts of the page in the browser: its keys, a gamepad that presses them, its width."""

# The field of a dropdown keeps the focus, and with it the keys, when an option has been chosen.
GIVE_KEYS_BACK = """
document.addEventListener("click", event => {
  if (event.target.closest("[role=option]")) document.activeElement.blur();
});
"""
# On a page as narrow as a phone (36 em) viser's panel is 20 em wide, at its right side.
WIDE_ON_A_PHONE = """
document.head.insertAdjacentHTML("beforeend", `<style>@media (max-width: 36em) {
  [style*="width: 20em"] { width: 100% !important; }
}</style>`);
"""
# A stick beyond its half repeats a key, and presses M when it is let go; a button acts once.
# Numbers of axes and buttons: https://w3c.github.io/gamepad/#remapping
GAMEPAD = """
window.slot_gamepad ??= setInterval((state => () => {
  const sticks = [[1, -1, "i"], [1, 1, "k"], [0, -1, "u"], [0, 1, "o"], [2, -1, "j"], [2, 1, "l"]];
  const buttons = [[0, "g"], [3, "h"], [1, "x"]];
  const press = key => document.body.dispatchEvent(new KeyboardEvent("keydown",
    {key, code: "Key" + key.toUpperCase(), bubbles: true}));
  const pad = navigator.getGamepads().find(p => p?.connected && p.mapping == "standard");
  const held = pad ? sticks.filter(([axis, sign]) => sign * pad.axes[axis] > 0.5) : [];
  const pressed = pad ? buttons.filter(([button]) => pad.buttons[button]?.pressed) : [];
  held.forEach(([,, key]) => press(key));
  if (state.held.length && !held.length) press("m");
  pressed.filter(([, key]) => !state.keys.includes(key)).forEach(([, key]) => press(key));
  Object.assign(state, {held, keys: pressed.map(([, key]) => key)});
})({held: [], keys: []}), 200);
"""
