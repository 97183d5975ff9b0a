// ---- the controls

const update = () => {
  const began = performance.now();
  const entry = answer(placesOf(), state.asked, state.takt_s);
  const given = remembered(["given", state.number, state.takt_s].join(),
    () => answer(facts.sequences[state.number].places, AS_LOGGED(), state.takt_s));
  showNumbers(entry, given);
  showChart(entry, given);
  section.dataset.took = String(performance.now() - began);
  part("toml").hidden = true;
  part("copied").textContent = "";
};

const describe = (visit) => visit.places.map(labelled).join(" \u2192 ");
const move = (from, to) => {
  if (to < 0 || to >= state.visits.length || to === from) return;
  state.visits.splice(to, 0, ...state.visits.splice(from, 1));
  list();
  update();
};
const button = (text, label, act) => {
  const found = made("button", "", text);
  found.type = "button";
  found.setAttribute("aria-label", label);
  found.addEventListener("click", act);
  return found;
};

const dragged = (handle, item) => {
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
      state.visits = [...item.parentElement.children].map((each) => state.visits[Number(each.dataset.visit)]);
      [...item.parentElement.children].forEach((each, index) => { each.dataset.visit = String(index); });
      update();
    }
  });
  const drop = () => {
    if (!item.classList.contains("held")) return;
    item.classList.remove("held");
    list();
  };
  handle.addEventListener("pointerup", drop);
  handle.addEventListener("pointercancel", drop);
};

const list = () => {
  const visits = part("visits");
  visits.replaceChildren(...state.visits.map((visit, index) => {
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
    item.classList.toggle("off", !visit.on);
    const step = (by) => () => {
      move(index, index + by);
      const moved = visits.children[index + by];
      const [back, on] = moved ? moved.querySelectorAll("button") : [];
      const focus = by < 0 ? [back, on] : [on, back];
      if (moved) (focus[0].disabled ? focus[1] : focus[0]).focus();
    };
    const name = { name: describe(visit) };
    const [earlier, later] = [button("\u2191", say("earlier", name), step(-1)), button("\u2193", say("later", name), step(1))];
    earlier.disabled = index === 0;
    later.disabled = index === state.visits.length - 1;
    const row = made("div", "play-row");
    row.append(handle, label, earlier, later);
    item.append(row, made("div", "play-lane"));
    dragged(handle, item);
    return item;
  }));
  const first = facts.sequences[state.number].places[0];
  part("start").textContent = labelled(first);
  part("end").hidden = state.end === null;
  part("end").querySelector(".play-row").textContent = state.end === null ? "" : labelled(state.end);
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

const AT_ONCE = 1.01; // behind 10 per s, on a logarithmic scale
const allSliders = () => {
  facts.rule.moves.forEach((each, index) => {
    const level = percent(each.level);
    const label = say(each.kind === "zone" ? "zone" : "threshold", { level });
    const tell = (by) => say("metres", { value: (each.value + by).toFixed(2) });
    const bounds = each.bounds.map((bound) => bound - each.value);
    const [low, high] = [Math.ceil(bounds[0] * 100 - NOTHING) / 100, Math.floor(bounds[1] * 100 + NOTHING) / 100];
    slider(label, [low, high], 0.01, 0, tell, (by) => { state.asked.moved[index] = by || 0; });
  });
  const logged = facts.dynamics.ramp_up_per_s;
  const start = logged ? Math.round(Math.log10(Math.min(logged, 10)) * 100) / 100 : AT_ONCE;
  const rate = (at) => (at > 1.005 ? Infinity : 10 ** at);
  const tell = (at) => (at > 1.005 ? say("at_once") : say("per_s", { value: Math.round(100 * (at === start ? logged : 10 ** at)) }));
  slider(say("recovery"), [-1.5, AT_ONCE], 0.01, start, tell, (at) => { state.asked.ramp = at === null ? null : rate(at); });
  part("fixed").hidden = !facts.rule.fixed;
  if (facts.rule.fixed) part("fixed").textContent = say(facts.rule.fixed);
  if (facts.rule.fixed === "fixed_table") return; // when he is away hangs on single points: only `whatif` knows
  const often = (by) => say("times", { value: by.toFixed(2) });
  slider(say("frequency"), [0.1, 2], 0.05, 1, often, (by) => { state.asked.frequency = by === null ? 1 : by; });
};

const begin = (number) => {
  state.number = number;
  Object.assign(state, visitsOf(facts.sequences[number].places));
  for (const reset of sliders) reset();
  list();
  update();
};

const start = async () => {
  await unpack();
  prepare();
  section.hidden = false;
  document.getElementById("to-play")?.removeAttribute("hidden"); // a template of one's own may lack it
  state.asked = AS_LOGGED();
  const select = part("sequence");
  select.append(...facts.sequences.map((each, index) => new Option(each.name, String(index))));
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
  allSliders();
  begin(0);
  section.dataset.ready = "yes";
};
window.cyclekitPlay = { ready: start(), answer: (places, asked, takt_s) => answer(places, { ...AS_LOGGED(), ...asked }, takt_s) };
