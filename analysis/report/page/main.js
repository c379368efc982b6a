// The page: what is chosen, what follows the address, and how the page of a running search reloads itself.

const state = {
    page: null,
    run: null,
    generation: 0,
    colour: "fitness",
    selected: undefined,
    sort: { name: "candidate", isFalling: false },
};

function show(page) {
    for (const run of page.runs) {
        run.byId = new Map(run.candidates.map((one) => [one.id, one]));
        run.children = d3.group(
            run.candidates.flatMap((one) => one.parents.map((parent) => [parent, one.id])),
            ([parent]) => parent,
        );
        run.children = new Map(
            [...run.children].map(([parent, pairs]) => [parent, [...new Set(pairs.map(([, id]) => id))]]),
        );
    }
    state.page = page;
    document.title = page.title;
    byId("title").textContent = page.title;
    byId("state").textContent = page.state;
    byId("checked").replaceChildren(...page.checked.map((line) => h("li", null, ...withCode(line))));
    byId("sweep-found").replaceChildren(...(page.sweep?.found ?? []).map((line) => h("li", null, line)));
    byId("replay").hidden = page.commands.length === 0;
    byId("commands").textContent = page.commands.join("\n");
    byId("run-label").hidden = page.runs.length < 2;
    byId("panels").hidden = page.runs.length === 0;
    if (page.runs.length === 0) return;
    choose(page.runs[0]);
    followAddress();
}

// The candidate that a run opens with.
const opening = (run) => (run?.generations.length ? bestOf(run) : undefined);

function choose(run) {
    state.run = run;
    state.generation = run.generations.length - 1;
    state.selected = opening(run);
    drawRun();
}

function drawRun() {
    const run = state.run;
    byId("found").replaceChildren(...run.found.map((line) => h("li", null, line)));
    byId("headlines").replaceChildren(...run.headlines.map((line) => h("p", null, ...withCode(line))));
    byId("remarks").replaceChildren(...run.remarks.map((line) => h("li", null, ...withCode(line))));
    const notes = run.remarks.length ? `, ${counted(run.remarks.length, "note")}` : "";
    byId("facts").querySelector("summary").textContent = `Facts${notes}`;
    drawSweep();
    drawMap();
    drawCandidate();
    drawLineage();
    drawTable();
    drawDynamics();
    drawPareto();
    drawStudies();
    showPanel("tables", run.tables.length > 0);
    byId("run-tables").replaceChildren(...run.tables.map(tableOf));
    showPanel("parts", run.sections.length > 0);
    byId("parts-body").replaceChildren(...run.sections.map(sectionOf));
    byId("provenance-facts").replaceChildren(...facts(run.provenance).childNodes);
    byId("settings").textContent = JSON.stringify(run.settings, null, 2);
    byId("samples").hidden = run.samples === null;
    if (run.samples) byId("samples-image").src = run.samples;
}

// Open the run and the candidate that the address names, if any, and what else a page that reloaded kept in it.
function followAddress() {
    if (location.hash === "" && state.selected !== opening(state.run)) select(opening(state.run)); // back to the start
    const [address, kept] = location.hash.split("?");
    const parts = address.split("/");
    if (parts[0] !== "#" || parts.length !== 3) return;
    let [name, id] = ["", ""];
    try {
        [name, id] = parts.slice(1).map(decodeURIComponent);
    } catch {
        return; // an address that was cut in the middle of a letter
    }
    const run = state.page.runs.find((one) => one.name === name);
    if (run !== undefined && run !== state.run && (id === "" || run.byId.has(id))) choose(run);
    select(run?.byId.has(id) ? id : id === "" ? opening(state.run) : undefined);
    if (kept !== undefined) {
        restore(new URLSearchParams(kept));
    } else if (state.selected !== undefined) {
        byId("candidate-name").focus();
    } else {
        byId("candidate-body").replaceChildren(h("p", null, `This page has no candidate ${id} of ${name}.`));
    }
}

function select(id) {
    state.selected = id;
    fillMap();
    drawTree(state.run);
    drawCandidate();
}

// The controls whose choice the address of a page that reloads keeps.
const KEPT = ["colour", ...FILTERS.map((name) => `filter-${name}`)];

// Return an address from which `followAddress` finds all that is chosen, and the place on the page.
function addressNow() {
    if (state.run === null) return location.hash;
    const kept = new URLSearchParams({ top: Math.round(scrollY) });
    if (state.generation < state.run.generations.length - 1) kept.set("generation", state.generation);
    for (const name of KEPT) kept.set(name, byId(name).value);
    const chosen = state.selected === opening(state.run) ? "" : (state.selected ?? "");
    return `${addressOf(state.run, chosen)}?${kept}`;
}

function restore(kept) {
    if (kept.has("generation")) {
        byId("generation").value = kept.get("generation");
        byId("generation").dispatchEvent(new Event("input"));
    }
    for (const control of KEPT.map(byId)) {
        if (![...control.options].some((option) => option.value === kept.get(control.id))) continue;
        control.value = kept.get(control.id);
        control.dispatchEvent(new Event("change"));
    }
    scrollTo(0, Number(kept.get("top")));
}

const QUIET = 3000; // milliseconds

// Reload, because the file may have been written again; not while its reader moves, types or scrolls.
function reloadWhenQuiet() {
    history.scrollRestoration = "manual"; // `restore` scrolls
    let since = Date.now();
    for (const kind of ["pointermove", "pointerdown", "keydown", "wheel"]) {
        addEventListener(kind, () => (since = Date.now()), { passive: true });
    }
    setInterval(() => {
        if (Date.now() - since < QUIET) return;
        history.replaceState(null, "", addressNow());
        location.reload();
    }, 1000);
}

byId("generation").oninput = (event) => {
    state.generation = Number(event.target.value);
    fillMap();
};
byId("colour").onchange = (event) => {
    state.colour = event.target.value;
    fillMap();
};
byId("run-choice").onchange = (event) => choose(state.page.runs[event.target.value]);
window.addEventListener("hashchange", followAddress);
window.addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((one) => (one.open = true)));
show(JSON.parse(byId("contents").textContent));
if (state.page.live) reloadWhenQuiet();
