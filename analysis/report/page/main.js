// The page: what is chosen, what follows the address, and how a live page asks for news.

const state = {
    page: null,
    text: "",
    run: null,
    generation: 0,
    colour: "fitness",
    selected: undefined,
    sort: { name: "candidate", isFalling: false },
};

// Show new contents; what was chosen stays chosen where it is still there.
function show(text) {
    const page = JSON.parse(text);
    const isFirst = state.run === null;
    const followed = isFirst || state.generation === state.run.generations.length - 1;
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
    const chosen = page.runs.find((run) => run.name === state.run?.name) ?? page.runs[0];
    state.page = page;
    state.text = text;
    document.title = page.title;
    byId("title").textContent = page.title;
    byId("state").textContent = page.state;
    byId("checked").replaceChildren(...page.checked.map((line) => h("li", null, line)));
    byId("replay").hidden = page.commands.length === 0;
    byId("commands").textContent = page.commands.join("\n");
    byId("run-label").hidden = page.runs.length < 2;
    byId("panels").hidden = chosen === undefined;
    if (chosen === undefined) return;
    state.run = chosen;
    if (followed || state.generation >= chosen.generations.length) state.generation = chosen.generations.length - 1;
    drawRun();
    if (isFirst) followAddress();
}

function choose(run) {
    state.run = run;
    state.generation = run.generations.length - 1;
    state.selected = undefined;
    drawRun();
}

function drawRun() {
    const run = state.run;
    byId("headlines").replaceChildren(...run.headlines.map((line) => h("p", null, line)));
    byId("remarks").replaceChildren(...run.remarks.map((line) => h("li", null, line)));
    drawSweep();
    drawMap();
    drawCandidate();
    drawLineage();
    drawTable();
    drawDynamics();
    drawStudies();
    showPanel("tables", run.tables.length > 0);
    byId("run-tables").replaceChildren(...run.tables.map(tableOf));
    byId("provenance-facts").replaceChildren(...facts(run.provenance).childNodes);
    byId("settings").textContent = JSON.stringify(run.settings, null, 2);
    byId("samples").hidden = run.samples === null;
    if (run.samples) byId("samples-image").src = run.samples;
}

// Open the candidate that the address names, if any.
function followAddress() {
    if (location.hash === "" && state.selected !== undefined) select(undefined); // back to where the page began
    const parts = location.hash.split("/");
    if (parts[0] !== "#" || parts.length !== 3) return;
    let [name, id] = ["", ""];
    try {
        [name, id] = parts.slice(1).map(decodeURIComponent);
    } catch {
        return; // an address that was cut in the middle of a letter
    }
    const run = state.page.runs.find((one) => one.name === name);
    if (!run?.byId.has(id)) {
        select(undefined);
        byId("candidate-body").replaceChildren(h("p", null, `This page has no candidate ${id} of ${name}.`));
        return;
    }
    if (run !== state.run) choose(run);
    select(id);
    byId("candidate-name").focus();
}

function select(id) {
    state.selected = id;
    fillMap();
    drawTree(state.run);
    drawCandidate();
}

// Ask for newer contents every two seconds; a server that is away may come back.
async function poll(version) {
    let [news, next, words] = [state.text, "", state.page.state];
    try {
        const answer = await fetch("data", { headers: { "If-None-Match": version }, cache: "no-store" });
        if (answer.status === 200) [news, next] = [await answer.text(), answer.headers.get("ETag")];
        else if (answer.status === 304) next = version;
        else words = "`tacevo watch` was started again under another address, which it has printed.";
    } catch {
        words = "No answer from `tacevo watch`; this page goes on asking.";
    }
    setTimeout(poll, 2000, next);
    if (byId("state").textContent !== words) byId("state").textContent = words; // said aloud when it is written
    if (news !== state.text) keepingPlace(() => show(news));
}

const SCROLLED = ["#lineage-tree", "#candidates .scroll", "#candidate pre.source"];

// Draw again; what the reader has opened, scrolled to, focused and chosen stays.
function keepingPlace(draw) {
    const nameOf = (one) =>
        [one.closest("figure")?.querySelector("figcaption"), one.querySelector("summary")]
            .map((part) => part?.textContent)
            .join();
    const opened = new Set([...document.querySelectorAll("details[open]")].map(nameOf));
    const scrolled = SCROLLED.map((name) => [name, document.querySelector(name)])
        .filter(([, node]) => node !== null)
        .map(([name, { scrollLeft, scrollTop }]) => [name, { left: scrollLeft, top: scrollTop }]);
    const page = { left: scrollX, top: scrollY };
    const focused = document.activeElement;
    const [box, href] = [focused.closest("[id]")?.id, focused.getAttribute("href")];
    const choice = byId("source-choice")?.value;
    draw();
    for (const one of document.querySelectorAll("details")) one.open ||= opened.has(nameOf(one));
    if (choice !== undefined && byId("source-choice")) {
        byId("source-choice").value = choice;
        byId("source-choice").onchange();
    }
    if (!focused.isConnected && box !== undefined) {
        const again = href === null ? byId(box) : byId(box)?.querySelector(`a[href="${CSS.escape(href)}"]`);
        again?.focus({ preventScroll: true });
    }
    for (const [name, place] of scrolled) document.querySelector(name)?.scrollTo(place);
    scrollTo(page);
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
show(byId("contents").textContent);
if (state.page.live) poll("");
