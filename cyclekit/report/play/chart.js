// ---- what is played with

const section = document.getElementById("play");
const part = (name) => section.querySelector(`[data-play="${name}"]`);
const made = (tag, className, text) => {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text !== undefined) element.textContent = text;
  return element;
};
const state = { number: 0, visits: [], end: null, asked: null, takt_s: facts.takt_s };

const visitsOf = (places) => { // a place that comes before many others is fetched from: it moves with the next ones
  const rest = places.slice(1);
  const end = rest.length > 1 && rest[rest.length - 1] === places[0] ? rest.pop() : null;
  const often = (place) => rest.filter((each) => each === place).length;
  const hub = rest.reduce((best, place) => (often(place) > often(best) ? place : best), rest[0]);
  const visits = [];
  for (const place of rest) {
    const last = visits[visits.length - 1];
    if (often(hub) > 1 && place !== hub && last && last.places[0] === hub) last.places.push(place);
    else visits.push({ places: [place], on: true });
  }
  return { visits, end };
};
const placesOf = () => {
  const first = facts.sequences[state.number].places[0];
  const middle = state.visits.filter((visit) => visit.on).flatMap((visit) => visit.places);
  return [first, ...middle, ...(state.end === null ? [] : [state.end])];
};
const tomlOf = () => {
  const quoted = (text) => JSON.stringify(text).replace(/\u007f/g, "\\u007f");
  const name = say("played", { name: facts.sequences[state.number].name });
  return `[[sequence]]\nname = ${quoted(name)}\nplaces = [${placesOf().map(quoted).join(", ")}]\n`;
};

const fixed = (seconds) => seconds.toFixed(1);
const apartFrom = (value, before) => {
  const by = value - before;
  if (Math.abs(by) < 0.05) return say("same");
  return say(by < 0 ? "shorter" : "longer", { by: fixed(Math.abs(by)) });
};

const showNumbers = (entry, given) => {
  const known = !entry.unknown;
  part("mean").textContent = known ? say("seconds", { value: fixed(entry.expected_s) }) : say("not_known");
  const interval = known ? say("interval", { low: fixed(entry.low_s), high: fixed(entry.high_s) }) : entry.unknown;
  part("interval").textContent = interval;
  part("change").textContent = known && !given.unknown ? apartFrom(entry.expected_s, given.expected_s) : "";
  const [low, , high] = known ? entry.quantiles_s : [];
  const cells = {
    single: known ? say("range", { low: fixed(low), high: fixed(high) }) : "\u2013",
    safety: known ? say("seconds", { value: fixed(entry.safety_s) }) : "\u2013",
    support: known ? percent(entry.support) : "\u2013",
    takt: known && entry.takt
      ? say("within", Object.fromEntries(["share", "low", "high"].map((name, n) => [name, percent(leastWide(entry.takt)[n])])))
      : "\u2013",
  };
  for (const [name, text] of Object.entries(cells)) part(name).textContent = text;
  part("thin").hidden = !(known && entry.support < 0.9);
  if (known) part("thin").textContent = say("extrapolated", { share: percent(1 - entry.support) });
};

const KINDS = ["motion", "slow", "dwell", "wait"];
const lane = (item, tasks, start_s, whole_s) => {
  const bar = item.querySelector(".play-lane");
  bar.replaceChildren();
  let at = start_s;
  for (const task of tasks) {
    const texts = [];
    const begin = at;
    task.parts.forEach((seconds, kind) => {
      if (seconds < 0.005) return;
      const piece = made("i", `play-${KINDS[kind]}`);
      piece.style.left = `${(100 * at) / whole_s}%`;
      piece.style.width = `${(100 * seconds) / whole_s}%`;
      at += seconds;
      bar.append(piece);
      texts.push(`${words[KINDS[kind]]} ${fixed(seconds)} s`);
    });
    const title = `${shown(task.name)}: ${fixed(begin)}\u2013${fixed(at)} s; ${texts.join(", ")}; ${say("seen", { count: task.logged })}`;
    for (const piece of bar.children) if (!piece.title) piece.title = title;
  }
  return at;
};

const showChart = (entry, given) => {
  const list = part("visits");
  for (const bar of section.querySelectorAll(".play-lane")) bar.replaceChildren();
  const slowest = Math.max(entry.expected_s || 0, given.expected_s || 0, state.takt_s || 0, 1);
  const every = [1, 2, 5, 10, 20, 30, 60, 120, 300].find((step) => slowest / step <= 7) || 600;
  const whole = Math.ceil(slowest / every) * every;
  const axis = part("axis");
  axis.replaceChildren();
  for (let tick = 0; tick <= whole + NOTHING; tick += every) {
    const mark = made("span", "", tick ? String(tick) : "0 s");
    mark.style.left = `${(100 * tick) / whole}%`;
    axis.append(mark);
  }
  section.style.setProperty("--play-every", `${(100 * every) / whole}%`);
  if (entry.unknown) return;
  let [at, first] = [0, 0];
  for (const item of list.children) {
    const visit = state.visits[Number(item.dataset.visit)];
    if (!visit.on) continue;
    at = lane(item, entry.tasks.slice(first, first + visit.places.length), at, whole);
    first += visit.places.length;
  }
  if (state.end !== null) lane(part("end"), entry.tasks.slice(first), at, whole);
};
