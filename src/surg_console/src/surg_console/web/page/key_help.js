// The keys of the console: in the footer, and all of them in the help.

const KEYS = [
  [["W", "A", "S", "D"], "in the picture"],
  [["R", "F"], "deeper, back"],
  [["Q", "E"], "roll"],
  [["K", "L"], "close, open the jaw"],
  [["Shift"], "slow"],
  [["Space"], "clutch"],
  [["C"], "camera"],
  [["Enter"], "enable"],
  [["Esc"], "stop"],
  [["V"], "record"],
  [["Drag"], "mouse; with Shift: deeper, roll"],
];

/** What the footer has no room for. */
const MORE_KEYS = [
  [["↑", "↓", "←", "→", "Page up", "Page down"], "for the right hand: in the picture, deeper, back"],
  [["Home", "End"], "for the right hand: roll"],
  [["7", "8", "9", "0"], "tilt a wrist: left, up, down, right"],
  [["Delete", "Insert"], "for the right hand: close, open the jaw"],
  [["M"], "mouse, or keys and gamepad"],
  [["−", "="], "scale"],
  [["[", "]"], "speed"],
  [["P"], "policy"],
  [["1", "2", "3"], "last recording: success, failure, discard"],
  [["G"], "new episode"],
  [["B"], "left eye, side by side"],
  [["Z"], "size of the pictures"],
  [["N"], "marks of the instruments"],
  [["I"], "what the policy plans and sees"],
  [["O"], "the arms in the room"],
  [["Y"], "force at the tip as a tone and a rumble"],
  [["T"], "take control"],
  [["H"], "guide the arm home"],
  [["J"], "left-handed layout"],
  [["?"], "this help"],
];

function keyRow(tag, keys, text) {
  const item = document.createElement(tag);
  for (const key of keys) item.append(Object.assign(document.createElement("kbd"), { textContent: key }));
  item.append(` ${text}`);
  return item;
}
for (const [keys, text] of KEYS) document.getElementById("keys").append(keyRow("span", keys, text));
for (const [keys, text] of [...KEYS, ...MORE_KEYS]) document.getElementById("help-keys").append(keyRow("li", keys, text));

// --- the help itself ---

const help = document.getElementById("help");
let before = null; // who had the focus by keyboard

/** Show or hide the help; the focus goes into it, and back to where it was. */
export function showHelp(open) {
  if (open === !help.hidden) return;
  if (open) before = document.activeElement?.matches(":focus-visible") ? document.activeElement : null;
  help.hidden = !open;
  for (const behind of ["main", "keys", "task", "judge"]) document.getElementById(behind).inert = open;
  if (open) document.getElementById("help-close").focus();
  else before?.focus();
}
for (const link of help.querySelectorAll("a")) link.href += location.hash; // the token
