// The page: what is chosen, what follows the address, and how a live page asks for news.

const state = {
    page: null,
    run: null,
    generation: 0,
    colour: "fitness",
    selected: undefined,
    sort: { name: "candidate", isFalling: false },
};

// Show new contents; what was chosen stays chosen where it is still there.
function show(page) {
    const followed = state.run === null || state.generation === state.run.generations.length - 1;
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
    document.title = page.title;
    byId("title").textContent = page.title;
    byId("state").textContent = page.state;
    byId("checked").replaceChildren(...page.checked.map((line) => h("li", null, line)));
    byId("replay").hidden = page.commands.length === 0;
    byId("commands").textContent = page.commands.join("\n");
    byId("panels").hidden = chosen === undefined;
    if (chosen === undefined) return;
    state.run = chosen;
    if (followed || state.generation >= chosen.generations.length) state.generation = chosen.generations.length - 1;
    drawRun();
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
    const parts = location.hash.split("/");
    if (parts[0] !== "#" || parts.length !== 3) return;
    let [name, id] = ["", ""];
    try {
        [name, id] = parts.slice(1).map(decodeURIComponent);
    } catch {
        return; // an address that was cut in the middle of a letter
    }
    const run = state.page.runs.find((one) => one.name === name);
    if (!run?.byId.has(id)) return;
    if (run !== state.run) choose(run);
    state.selected = id;
    fillMap();
    drawTree(run);
    drawCandidate();
    byId("candidate-name").focus();
}

// Ask for newer contents every two seconds; a server that is away may come back.
async function poll(version) {
    let next = version;
    try {
        const answer = await fetch("data", { headers: { "If-None-Match": version }, cache: "no-store" });
        if (answer.status === 200) {
            show(await answer.json());
            next = answer.headers.get("ETag");
        }
    } catch {
        byId("state").textContent = "No answer from `tacevo watch`; this page goes on asking.";
        next = "";
    }
    setTimeout(poll, 2000, next);
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
followAddress();
if (state.page.live) poll("");
