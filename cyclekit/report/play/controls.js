// ---- the controls

const ANSWERS = { robot: answer, both: answerBoth, list: answerList };
const asLogged = () => ({
  robot: AS_LOGGED,
  both: () => ({ moved: facts.rule.moves.map(() => 0), ramp: null, pace: 1, without: [], more: {}, buffer: {} }),
  list: () => ({ paces: {}, without: [] }),
}[facts.kind])();
const SLICE_MS = 40; // then what is known so far is shown, and the rest is rolled out afterwards
let turn = 0;
const show = (slice_ms = SLICE_MS) => {
  const began = performance.now();
  const entry = ANSWERS[facts.kind](played(state.blocks), structuredClone(state.asked), state.takt_s, began + slice_ms);
  const before = ANSWERS[facts.kind](played(blocksOf(given())), asLogged(), state.takt_s, began + slice_ms);
  showNumbers(entry, before);
  showChart(entry, before);
  showAsked();
  const walked = [entry, before].map((each) => (each.walked === undefined ? Infinity : each.walked));
  const all = facts.kind === "robot" ? COUNT : facts.cycles;
  const whole = Math.min(...walked) >= all;
  part("so_far").hidden = whole;
  if (!whole) part("so_far").textContent = say("so_far", { count: Math.min(...walked), of: all });
  section.dataset.took = String(performance.now() - began);
  section.dataset.whole = whole ? "yes" : "no";
  const mine = turn;
  if (!whole) setTimeout(() => { if (mine === turn) show(2 * SLICE_MS); }, 0);
};
const update = () => {
  turn += 1;
  show();
  part("toml").hidden = true;
  part("copied").textContent = "";
};

const describe = (visit) => visit.places.map(shown).join(" \u2192 ");
const askedLine = (tasks) => { // what a plan asks of a visit: earliest starts, and tasks that end before it
  const asking = tasks.filter((task) => task && (task.after.length || task.not_before_s));
  if (!asking.length) return [];
  const found = made("small", "play-asked");
  found.asking = asking;
  return [found];
};
const showAsked = () => { // tasks of the robot are called by where they start, which the order changes
  const asked = given().asked && played(state.blocks);
  const plan = asked ? askedOf(asked.robot, asked.asked) : { robot: [], operator: [] };
  const calledNow = new Map([...plan.robot, ...plan.operator].map((task) => [task.number, task.called]));
  const called = (one) => shown(calledNow.get(one.number) || one.name || one);
  for (const place of section.querySelectorAll(".play-asked")) {
    place.textContent = place.asking.flatMap((task) => [
      ...(task.not_before_s ? [say("told_start", { value: task.not_before_s })] : []),
      ...(task.after.length ? [say("told_after", { tasks: task.after.map(called).join(", ") })] : []),
    ]).join("; ");
  }
};
const move = (block, from, to) => {
  if (to < 0 || to >= block.visits.length || to === from) return;
  block.visits.splice(to, 0, ...block.visits.splice(from, 1));
  list(block);
  update();
};
const button = (text, label, act) => {
  const found = made("button", "", text);
  found.type = "button";
  found.setAttribute("aria-label", label);
  found.addEventListener("click", act);
  return found;
};

const dragged = (block, handle, item) => {
  handle.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    event.preventDefault();
    handle.setPointerCapture(event.pointerId);
    item.classList.add("held");
  });
  handle.addEventListener("pointermove", (event) => {
    if (!handle.hasPointerCapture(event.pointerId)) return;
    const others = [...item.parentElement.children].filter((each) => each !== item);
    const below = others.find((each) => {
      const box = each.getBoundingClientRect();
      return event.clientY < box.top + box.height / 2;
    });
    const next = below || null;
    if (item.nextElementSibling !== next) {
      item.parentElement.insertBefore(item, next);
      handle.setPointerCapture(event.pointerId); // it is lost where the item moves
      block.visits = [...item.parentElement.children].map((each) => block.visits[Number(each.dataset.visit)]);
      [...item.parentElement.children].forEach((each, index) => { each.dataset.visit = String(index); });
      update();
    }
  });
  const drop = () => {
    if (!item.classList.contains("held")) return;
    item.classList.remove("held");
    list(block);
    showAsked();
  };
  handle.addEventListener("pointerup", drop);
  handle.addEventListener("pointercancel", drop);
};

const list = (block) => {
  const visits = block.list;
  visits.replaceChildren(...block.visits.map((visit, index) => {
    const item = made("li");
    item.dataset.visit = String(index);
    const handle = made("span", "play-handle", "\u2261");
    handle.setAttribute("aria-hidden", "true");
    const label = made("label");
    const box = made("input");
    box.type = "checkbox";
    box.checked = visit.on;
    box.addEventListener("change", () => {
      visit.on = box.checked;
      item.classList.toggle("off", !visit.on);
      update();
    });
    label.append(box, ` ${describe(visit)}`);
    label.append(...askedLine(visit.task ? [visit.task] : visit.asked));
    item.classList.toggle("off", !visit.on);
    const step = (by) => () => {
      move(block, index, index + by);
      const moved = visits.children[index + by];
      const [back, on] = moved ? moved.querySelectorAll("button") : [];
      const focus = by < 0 ? [back, on] : [on, back];
      if (moved) (focus[0].disabled ? focus[1] : focus[0]).focus();
    };
    const name = { name: describe(visit) };
    const [earlier, later] = [button("\u2191", say("earlier", name), step(-1)), button("\u2193", say("later", name), step(1))];
    earlier.disabled = index === 0;
    later.disabled = index === block.visits.length - 1;
    const row = made("div", "play-row");
    row.append(handle, label, earlier, later);
    item.append(row, made("div", "play-lane"));
    dragged(block, handle, item);
    return item;
  }));
};
const line = (text, bar, asked = []) => {
  const found = made("div", "play-line");
  found.append(made("div", "play-row", text), made("div", bar));
  found.firstChild.append(...askedLine(asked));
  if (bar === "play-axis") found.lastChild.setAttribute("aria-hidden", "true");
  return found;
};
const lay = () => { // each agent's lines: what it begins with, its visits, and where it ends
  const persons = section.querySelector(".play-key .play-person");
  if (persons) persons.parentElement.hidden = facts.kind !== "both" || !state.blocks.some(({ agent }) => agent === "operator");
  part("agents").replaceChildren(...state.blocks.map((block) => {
    const found = made("div", "play-agent");
    const alone = facts.kind === "robot";
    found.append(line(alone ? labelled(block.first) : say("agent", { agent: block.agent }), "play-axis"));
    if (!alone) found.firstChild.classList.add("play-who");
    block.start = line(block.first === null ? "" : labelled(block.first), "play-lane", [block.firstAsked]);
    block.list = made("ol");
    block.last = line(block.end === null ? "" : labelled(block.end), "play-lane", [block.endAsked]);
    if (!alone && block.first !== null) found.append(block.start);
    found.append(block.list);
    if (block.end !== null) found.append(block.last);
    list(block);
    return found;
  }));
};

const sliders = [];
const slider = (label, bounds, step, start, tell, set) => {
  const row = made("div", "play-slider");
  const name = made("label", "", label);
  const input = made("input");
  const value = made("output");
  const back = button(say("as_logged"), `${label}: ${say("as_logged")}`, () => {
    input.value = String(start);
    input.dispatchEvent(new Event("input"));
  });
  input.type = "range";
  [input.min, input.max, input.step] = [...bounds, step].map(String);
  input.id = `play-slider-${sliders.length}`;
  name.htmlFor = input.id;
  value.htmlFor = input.id;
  const turn = () => {
    const now = Number(input.value);
    const logged = Math.abs(now - start) < step / 2;
    set(logged ? null : now);
    value.textContent = logged ? say("logged", { value: tell(start) }) : tell(now);
    input.setAttribute("aria-valuetext", value.textContent);
    back.disabled = logged;
  };
  input.addEventListener("input", () => { turn(); update(); });
  row.append(name, input, value, back);
  part("sliders").append(row);
  const reset = () => { input.value = String(start); turn(); };
  sliders.push(reset);
  reset();
};

const times = (by) => say("times", { value: fixed(by, 2) });
const AT_ONCE = 1.01; // behind 10 per s, on a logarithmic scale
const ofSafety = () => { // thresholds, zones, and how s recovers
  facts.rule.moves.forEach((each, index) => {
    const level = percent(each.level, 0);
    const label = say(each.kind === "zone" ? "zone" : "threshold", { level });
    const tell = (by) => say("metres", { value: fixed(each.value + by, 2) });
    const bounds = each.bounds.map((bound) => bound - each.value);
    const [low, high] = [Math.ceil(bounds[0] * 100 - NOTHING) / 100, Math.floor(bounds[1] * 100 + NOTHING) / 100];
    slider(label, [low, high], 0.01, 0, tell, (by) => { state.asked.moved[index] = by || 0; });
  });
  const logged = facts.dynamics.ramp_up_per_s;
  const start = logged ? Math.round(Math.log10(Math.min(logged, 10)) * 100) / 100 : AT_ONCE;
  const rate = (at) => (at > 1.005 ? Infinity : 10 ** at);
  const tell = (at) => (at > 1.005 ? say("at_once") : say("per_s", { value: fixed(100 * (at === start ? logged : 10 ** at), 0) }));
  slider(say("recovery"), [-1.5, AT_ONCE], 0.01, start, tell, (at) => { state.asked.ramp = at === null ? null : rate(at); });
};
const waitSwitches = (names) => { // waits that nobody has to wait any more
  for (const { name, text } of names) {
    const label = made("label", "play-switch");
    const box = made("input");
    box.type = "checkbox";
    box.addEventListener("change", () => {
      state.asked.without = [...section.querySelectorAll(".play-switch input")].filter((each) => each.checked).map((each) => each.value);
      update();
    });
    box.value = name;
    label.append(box, ` ${text}`);
    part("sliders").append(label);
    sliders.push(() => { box.checked = false; });
  }
};
const allSliders = () => {
  if (facts.kind === "list") {
    for (const agent of Object.keys(facts.agents)) {
      slider(say("pace", { agent }), facts.paces, 0.01, 1, times, (by) => { state.asked.paces[agent] = by || 1; });
    }
    waitSwitches(facts.tasks.flatMap((card) => everyWait(card).map((need) => ({
      name: waitName(card, need), text: say("no_wait", { task: card.task, other: need.task }),
    }))));
    return;
  }
  ofSafety();
  part("fixed").hidden = !facts.rule.fixed;
  if (facts.rule.fixed) part("fixed").textContent = say(facts.kind === "both" && facts.rule.fixed === "fixed_table" ? "fixed_both" : facts.rule.fixed);
  if (facts.kind === "both") {
    slider(say("pace", { agent: "operator" }), facts.paces, 0.01, 1, times, (by) => { state.asked.pace = by || 1; });
    for (const source of facts.sources) {
      const most = Math.max(facts.most_parts, source.buffer);
      const parts = (count) => say("parts", { count });
      slider(say("buffer", { signal: source.signal }), [1, most], 1, source.buffer, parts, (count) => {
        state.asked.buffer[source.signal] = count || source.buffer;
      });
    }
    waitSwitches(facts.gates.filter((gate) => gate.conditions.length).map((gate) => ({
      name: gate.name, text: say(gate.at === "leave" ? "no_leave" : "no_approach", { agent: gate.agent, place: labelled(gate.place) }),
    })));
    return;
  }
  if (facts.rule.fixed === "fixed_table") return; // when he is away hangs on single points: only `whatif` knows
  slider(say("frequency"), [0.1, 2], 0.05, 1, times, (by) => { state.asked.frequency = by === null ? 1 : by; });
};

const begin = (number) => {
  state.number = number;
  const { part: entered } = SEQUENCES[number];
  if (entered.facts !== facts || !sliders.length) {
    enter(entered);
    kept.clear();
    for (const each of section.querySelectorAll("[data-kinds]")) {
      each.hidden = !each.dataset.kinds.split(" ").includes(facts.kind);
    }
    part("sliders").replaceChildren();
    sliders.length = 0;
    state.asked = asLogged();
    allSliders();
  }
  state.asked = asLogged();
  state.blocks = blocksOf(given());
  for (const reset of sliders) reset();
  lay();
  update();
};

const start = async () => {
  await Promise.all(told.parts.map(unpack));
  enter(told.parts[0]);
  section.hidden = false;
  document.getElementById("to-play")?.removeAttribute("hidden"); // a template of one's own may lack it
  const select = part("sequence");
  select.append(...SEQUENCES.map(({ sequence }, index) => new Option(sequence.name, String(index))));
  select.addEventListener("change", () => begin(Number(select.value)));
  part("reset").addEventListener("click", () => begin(state.number));
  const takt = part("takt_s");
  takt.value = state.takt_s === null ? "" : String(state.takt_s);
  takt.addEventListener("input", () => { state.takt_s = Number(takt.value) || null; update(); });
  part("copy").addEventListener("click", async () => {
    const text = part("toml");
    text.value = tomlOf();
    text.hidden = false;
    text.select();
    let copied = false;
    try {
      await navigator.clipboard.writeText(text.value);
      copied = true;
    } catch {
      copied = document.execCommand("copy");
    }
    part("copied").textContent = say(copied ? "copied" : "select_it");
  });
  begin(0);
  section.dataset.ready = "yes";
};
window.cyclekitPlay = {
  ready: start(), now: () => played(state.blocks), answer: (asked, changed, takt_s, until) => ANSWERS[facts.kind](asked, { ...asLogged(), ...changed }, takt_s, until),
};
