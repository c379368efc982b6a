// What all panels use: elements, numbers, links to candidates, arrow keys. Text enters the page by `append` only.

const byId = (id) => document.getElementById(id);

// Make an HTML element; children are elements or texts, and null is none.
function h(name, attributes, ...children) {
    const node = document.createElement(name);
    for (const [key, value] of Object.entries(attributes ?? {})) {
        if (value !== null && value !== undefined) node.setAttribute(key, value);
    }
    node.append(...children.filter((child) => child !== null));
    return node;
}

// Cut a sentence into texts and what stands in backticks, which is code.
const withCode = (sentence) =>
    sentence.split("`").length % 2
        ? sentence.split("`").map((part, at) => (at % 2 ? h("code", null, part) : part))
        : [sentence];

// As in the tables (analysis/rounding.py): three significant digits, and all digits before the point.
function number(value) {
    if (value === null || value === undefined) return "–";
    if (Number.isInteger(value)) return d3.format(",")(value);
    const size = Math.abs(value);
    return d3.format(size < 1e-4 ? ".2e" : size < 1000 ? ".3r" : ",.0f")(value);
}

// Show a panel and its link, or neither.
function showPanel(id, isShown) {
    byId(id).hidden = !isShown;
    document.querySelector(`nav a[href="#${id}"]`).hidden = !isShown;
}

// Whether the grammar answered, whose temperature is a mutation strength.
const isByGrammar = (run) => run.settings.llm?.provider === "grammar";

// What carries the temperatures of requests, for behind their name; empty where they are sent as such.
const carriedBy = (run) => {
    const carrier = run.settings.temperature?.carrier;
    return carrier === undefined ? "" : ` (carried by ${carrier === "none" ? "nothing" : carrier})`;
};

// Per cent as in the tables: 57.0 %; on an axis without digits that are 0.
const percent = (share) => (share === null || share === undefined ? "–" : `${d3.format(".1f")(100 * share)} %`);

const tickPercent = (share) => `${d3.format(",~r")(100 * share)} %`;

const counted = (count, noun) => `${number(count)} ${noun}${count === 1 ? "" : "s"}`;

// A candidate's address within the page; the first part is the run's, of which a sweep has many.
const addressOf = (run, id) => `#/${encodeURIComponent(run.name)}/${encodeURIComponent(id)}`;

const linkTo = (run, id) => h("a", { href: addressOf(run, id) }, id);

const listOf = (nodes) => nodes.flatMap((node, place) => (place ? [", ", node] : [node]));

const lossOf = (one) => `loss ${number(one.fitness)}`;

// Say a loss with what further trainings gave.
function lossWords(one) {
    const again = one.again.length ? `, trained again ${number(d3.median(one.again))}` : "";
    return `${lossOf(one)}${again}`;
}

// What the archive did with a trained candidate; a rejection is what the gate or a training decides.
const statusOf = (one) => (one.status === "rejected" ? "not inserted" : one.status);

// What an archive has: niches, or places where it has none.
const placeName = (run) => (run.cells.length ? "niche" : "place");

// What a candidate was asked by: an instruction of the library, or its operator where it has none.
const instructionOf = (run, one) => (one.prompt === null ? one.operator : run.instructions[one.prompt].id);

// Give a group of links one stop of the Tab key; arrow keys go to the nearest link in their direction, PageDown and
// PageUp to the next and the previous one, wherever they are: two can be at one point.
function withArrowKeys(links, placeOf, first) {
    const nodes = [...links];
    nodes.forEach((node) => node.setAttribute("tabindex", node === first ? 0 : -1));
    const directions = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    for (const node of nodes) {
        node.onkeydown = (event) => {
            const direction = directions[event.key];
            const step = { PageDown: 1, PageUp: -1 }[event.key];
            if (direction === undefined && step === undefined) return;
            event.preventDefault();
            const next = step ? nodes.at((nodes.indexOf(node) + step) % nodes.length) : nearestTo(node, direction);
            if (next === undefined) return;
            node.setAttribute("tabindex", -1);
            next.setAttribute("tabindex", 0);
            next.focus();
        };
    }
    function nearestTo(node, direction) {
        const [x, y] = placeOf(node);
        const ahead = nodes.flatMap((other) => {
            const [dx, dy] = [placeOf(other)[0] - x, placeOf(other)[1] - y];
            const along = dx * direction[0] + dy * direction[1];
            const aside = Math.abs(dx * direction[1]) + Math.abs(dy * direction[0]);
            return along > 0.5 ? [[along + 2 * aside, other]] : [];
        });
        return d3.least(ahead, (entry) => entry[0])?.[1];
    }
}
