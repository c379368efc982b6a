// All candidates in a table that filters and sorts.

const outcomeOf = (one) => (one.skipped ? "skipped" : one.stage === null ? "trained" : `rejected at ${one.stage}`);

const COLUMNS = [
    { name: "candidate", value: (run, one) => one.id, cell: (run, one) => linkTo(run, one.id) },
    { name: "generation", value: (run, one) => one.generation, isNumber: true },
    { name: "operator", value: (run, one) => one.operator },
    { name: "instruction", value: (run, one) => instructionOf(run, one) },
    { name: "temperature", value: (run, one) => one.temperature, isNumber: true },
    { name: "outcome", value: (run, one) => outcomeOf(one) },
    { name: "reason", value: (run, one) => one.reason ?? "" },
    { name: "status", value: (run, one) => (one.status === null ? "" : statusOf(one)) },
    { name: "loss", value: (run, one) => one.fitness, isNumber: true },
    { name: "parameters", value: (run, one) => one.parameters, isNumber: true },
    { name: "FLOPs", value: (run, one) => one.flops, isNumber: true },
];

const FILTERS = ["outcome", "operator", "instruction", "status"];

function drawTable() {
    const run = state.run;
    const columns = new Map(COLUMNS.map((column) => [column.name, column]));
    const rows = run.candidates.map((one) => ({ one, node: rowOf(run, one) }));
    const body = h("tbody", null);
    const chosen = () => new Map(FILTERS.map((name) => [name, byId(`filter-${name}`).value]));
    const filters = FILTERS.map((name) => {
        const values = d3.sort(new Set(run.candidates.map((one) => columns.get(name).value(run, one)))).filter(Boolean);
        const options = [h("option", { value: "" }, "all"), ...values.map((value) => h("option", { value }, value))];
        const kept = byId(`filter-${name}`)?.value; // of the run that was shown before
        const select = h("select", { id: `filter-${name}` }, ...options);
        if (values.includes(kept)) select.value = kept;
        select.onchange = () => filter();
        return h("label", null, `${name} `, select);
    });
    byId("filters").replaceChildren(...filters);
    const filter = () => {
        const wanted = chosen();
        let shown = 0;
        for (const { one, node } of rows) {
            node.hidden = FILTERS.some(
                (name) => wanted.get(name) && wanted.get(name) !== columns.get(name).value(run, one),
            );
            shown += !node.hidden;
        }
        byId("table-words").textContent = `${counted(shown, "candidate")} of ${number(rows.length)}.`;
        walk();
    };
    // One stop of the Tab key for all links that are shown, in their order.
    const walk = () => {
        const links = [...body.rows].filter((row) => !row.hidden).map((row) => row.querySelector("a"));
        const place = new Map(links.map((link, at) => [link, [0, at]]));
        withArrowKeys(links, (link) => place.get(link), links[0]);
    };
    const sort = () => {
        const { value } = columns.get(state.sort.name);
        const order = state.sort.isFalling ? d3.descending : d3.ascending;
        const isAbsent = ({ one }) => value(run, one) === null || value(run, one) === "";
        const ranked = d3.sort(
            rows,
            (a, b) => isAbsent(a) - isAbsent(b) || order(value(run, a.one), value(run, b.one)),
        );
        body.replaceChildren(...ranked.map(({ node }) => node));
        heads.forEach((head, place) => {
            const isOne = COLUMNS[place].name === state.sort.name;
            head.setAttribute("aria-sort", isOne ? (state.sort.isFalling ? "descending" : "ascending") : "none");
        });
    };
    const heads = COLUMNS.map(({ name, isNumber }) => {
        const button = h("button", { type: "button" }, name);
        button.onclick = () => {
            state.sort = { name, isFalling: state.sort.name === name && !state.sort.isFalling };
            sort();
            walk();
        };
        return h("th", { scope: "col", class: isNumber ? "number" : null }, button);
    });
    byId("candidates-table").replaceChildren(h("thead", null, h("tr", null, ...heads)), body);
    sort();
    filter();
}

function rowOf(run, one) {
    const cells = COLUMNS.map(({ value, cell, isNumber }, place) => {
        const content = cell ? cell(run, one) : isNumber ? number(value(run, one)) : value(run, one);
        return h(place ? "td" : "th", { class: isNumber ? "number" : null, scope: place ? null : "row" }, content);
    });
    return h("tr", null, ...cells);
}
