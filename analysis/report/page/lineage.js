// Where networks come from: the best one's line back to the baseline, and all elites with their ancestors.

function ancestorsOf(run, id) {
    const found = new Set();
    const waiting = [id];
    while (waiting.length) {
        const name = waiting.pop();
        if (found.has(name)) continue;
        found.add(name);
        waiting.push(...run.byId.get(name).parents);
    }
    return run.candidates.filter((one) => found.has(one.id)).map((one) => one.id);
}

function descendantsOf(run, id) {
    const found = new Set();
    const waiting = [...(run.children.get(id) ?? [])];
    while (waiting.length) {
        const name = waiting.pop();
        if (!found.has(name)) waiting.push(...(run.children.get(name) ?? []));
        found.add(name);
    }
    return run.candidates.filter((one) => found.has(one.id)).map((one) => one.id);
}

const bestOf = (run) => d3.least(run.generations.at(-1).elites, ([, id]) => run.byId.get(id).fitness)?.[1];

function drawLineage() {
    const run = state.run;
    const best = bestOf(run);
    byId("lineage-line").replaceChildren(...(best === undefined ? [] : lineTo(run, best)));
    drawTree(run);
}

// Follow the better parent of each network back to the baseline.
function lineTo(run, id) {
    const items = [];
    for (let one = run.byId.get(id); one !== undefined;) {
        const parents = d3.sort(
            one.parents.map((name) => run.byId.get(name)),
            (parent) => parent.fitness,
        );
        const by = parents.length
            ? `${instructionOf(run, one)}${
                  parents.length > 1
                      ? ` with ${parents
                            .slice(1)
                            .map((other) => other.id)
                            .join(", ")}`
                      : ""
              }`
            : instructionOf(run, one);
        items.unshift(
            h("li", null, h("span", { class: "edge" }, by), linkTo(run, one.id), ` ${lossWords(one)}`),
        );
        one = parents[0];
    }
    return items;
}

const TREE = { left: 40, top: 14, step: 26, column: 72, width: 720, letter: 6.2 };

// The baseline stands before generation 0.
const columnOf = (one) => (one.operator === "baseline" ? -1 : one.generation);

function drawTree(run) {
    const elites = new Set(run.generations.at(-1).elites.map(([, id]) => id));
    const names = new Set([...elites].flatMap((id) => ancestorsOf(run, id)));
    const nodes = run.candidates.filter((one) => names.has(one.id));
    const place = new Map();
    const columns = d3.group(nodes, columnOf);
    const tallest = d3.max([...columns.values()], (column) => column.length) ?? 0;
    const edgeName = (one) => instructionOf(run, one);
    const letters = d3.max(nodes, (one) => edgeName(one).length) ?? 0;
    const step = Math.max(TREE.column, 34 + letters * TREE.letter);
    const width = Math.max(TREE.width, TREE.left * 2 + step * run.generations.length);
    const height = TREE.top * 2 + TREE.step * Math.max(tallest, 4) + 20;
    const x = d3.scaleLinear([-1, Math.max(run.generations.length - 1, 1)], [TREE.left, width - TREE.left]);
    for (const [generation, column] of columns) {
        const wish = (one) => d3.mean(one.parents, (id) => place.get(id)?.[1]) ?? height / 2;
        d3.sort(column, wish).forEach((one, at) => {
            place.set(one.id, [x(generation), height / 2 + (at - (column.length - 1) / 2) * TREE.step - 6]);
        });
    }
    const svg = d3.create("svg").attr("viewBox", `0 0 ${width} ${height}`).attr("width", width).attr("height", height);
    svg.attr("role", "group").attr(
        "aria-label",
        "Elites and their ancestors by generation. Arrow keys go to the nearest one, PageDown to the next.",
    );
    for (const generation of columns.keys()) {
        svg.append("text")
            .attr("class", "muted")
            .attr("x", x(generation))
            .attr("y", height - 2)
            .attr("text-anchor", "middle")
            .text(generation < 0 ? "baseline" : generation);
    }
    const edges = nodes.flatMap((one) => one.parents.map((parent) => ({ parent, one })));
    const link = d3
        .linkHorizontal()
        .source(({ parent }) => place.get(parent))
        .target(({ one }) => place.get(one.id));
    const groups = svg.append("g").selectAll("path").data(edges).join("path").attr("class", "edge").attr("d", link);
    groups.append("title").text(({ parent, one }) => `${parent} to ${one.id}: ${instructionOf(run, one)}`);
    // The edges of a child have its instruction, and come in from its left.
    const edgeNames = svg
        .append("g")
        .attr("class", "edge-names")
        .attr("aria-hidden", "true")
        .selectAll("text")
        .data(nodes.filter((one) => one.parents.length))
        .join("text")
        .attr("text-anchor", "end")
        .attr("transform", (one) => `translate(${place.get(one.id)})`)
        .attr("x", -9)
        .attr("y", -3)
        .text(edgeName);
    const scale = colouring(run, "fitness");
    const links = svg
        .append("g")
        .selectAll("a")
        .data(nodes)
        .join("a")
        .attr("href", (one) => addressOf(run, one.id));
    links.attr(
        "aria-label",
        (one) =>
            `${one.id}, by ${instructionOf(run, one)} from ${one.parents.join(" and ") || "nothing"}, ${lossOf(one)}`,
    );
    links.attr("transform", (one) => `translate(${place.get(one.id)})`).attr("class", "node");
    links
        .append("path")
        .attr("fill", (one) => scale.of(one))
        .attr("d", (one) =>
            d3.symbol(elites.has(one.id) ? d3.symbolCircle : d3.symbolSquare, elites.has(one.id) ? 90 : 45)(),
        );
    links.append("title").text((one) => `${one.id}: ${lossOf(one)}`);
    const box = byId("lineage-tree");
    box.replaceChildren(svg.node());
    const shown = names.has(state.selected) ? state.selected : bestOf(run);
    if (shown !== undefined) {
        // Begin behind the nodes of a column, so that the names before the next one are whole.
        const wish = place.get(shown)[0] - box.clientWidth / 2;
        const starts = [...columns.keys()].map(x).filter((start) => start <= wish);
        box.scrollLeft = starts.length ? d3.max(starts) + 8 : 0;
    }
    const first = links.nodes().find((node) => d3.select(node).datum().id === shown);
    withArrowKeys(links.nodes(), (node) => place.get(d3.select(node).datum().id), first);
    const light = (id) => {
        const line = new Set(id === undefined ? [] : ancestorsOf(run, id));
        groups.classed("is-lit", ({ parent, one }) => line.has(parent) && line.has(one.id));
        edgeNames.classed("is-lit", (one) => line.has(one.id));
        links.classed("is-lit", (one) => line.has(one.id)).classed("is-selected", (one) => one.id === state.selected);
    };
    const rest = () => light(shown);
    links.on("pointerenter focus", (_, one) => light(one.id)).on("pointerleave blur", rest);
    rest();
}
