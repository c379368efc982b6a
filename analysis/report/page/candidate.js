// One candidate: what was asked, what became of it, and its source beside a parent's.

function drawCandidate() {
    const run = state.run;
    const one = run.byId.get(state.selected);
    const panel = byId("candidate-body");
    if (one === undefined) {
        byId("candidate-name").textContent = "Candidate";
        panel.replaceChildren(h("p", null, "Choose an elite on the map, or a candidate in the table or the lineage."));
        return;
    }
    byId("candidate-name").textContent = `Candidate ${one.id}`;
    const losses = one.validation_losses?.length
        ? lineChart({
              caption: "Loss after each epoch.",
              xName: "epoch",
              from: 1,
              yName: "loss",
              scaleOf: lossScale,
              series: [
                  { name: "validation", values: one.validation_losses },
                  ...(one.train_losses?.length ? [{ name: "training", values: one.train_losses }] : []),
              ],
          })
        : null;
    panel.replaceChildren(
        ...[inShort(run, one), requestOf(run, one), sourceOf(run, one), rejectedOf(one), losses, factsOf(run, one)].filter(
            (part) => part !== null,
        ),
    );
}

// The first line: what it is worth, and its size.
function inShort(run, one) {
    if (one.fitness === null) return null;
    return h("p", { class: "in-short" }, `${lossWords(one)}; ${counted(one.parameters, "parameter")}, ${counted(one.flops, "FLOP")}.`);
}

function facts(pairs) {
    return h("dl", null, ...pairs.flatMap(([name, ...value]) => [h("dt", null, name), h("dd", null, ...value)]));
}

function factsOf(run, one) {
    const measured = one.point.length
        ? [
              ...run.axes.map((name, axis) => [name, number(one.point[axis])]),
              ["Parameters", number(one.parameters)],
              ["FLOPs", number(one.flops)],
          ]
        : [];
    const fitness = one.fitness === null ? [] : [["Validation loss", number(one.fitness)]];
    if (one.again.length) {
        const all = one.again.map(number).join(", ");
        fitness.push(["Trained again", `${number(d3.median(one.again))}, the median of ${all}`]);
    }
    const descendants = descendantsOf(run, one.id);
    const held = one.fitness === null ? [] : [[run.cells.length ? "Niches held" : "Places held", nichesHeld(run, one)]];
    return facts([
        ["Made in", `generation ${one.generation}, slot ${one.slot}`],
        ["Gate, and training", gatePath(run, one)],
        ...fitness,
        ...measured,
        ...(one.status === null ? [] : [["When it was made", `${placeName(run)} ${one.niche}: ${statusOf(one)}`]]),
        ...held,
        ["Parents", ...linksTo(run, one.parents)],
        [
            "All ancestors",
            ...linksTo(
                run,
                ancestorsOf(run, one.id).filter((id) => id !== one.id),
            ),
        ],
        ["Children", ...linksTo(run, run.children.get(one.id) ?? [])],
        ["All descendants", ...folding(linksTo(run, descendants), descendants.length)],
    ]);
}

// What each answer passed, and where it was rejected. From what no model was asked for, a baseline, nothing is extracted.
function gatePath(run, one) {
    const all = Object.keys(run.generations[0].rejected);
    const stages = one.temperature === null ? all.filter((stage) => stage !== "extract") : all;
    const answers = [...one.repairs, one];
    const ways = answers.map(({ stage, reason }, at) => {
        let passed = stages;
        let end = [];
        if (stage !== null) {
            passed = stages.slice(0, stages.indexOf(stage));
            end = [`${stage}: rejected (${reason})${at < one.repairs.length ? ", sent back" : ""}`];
        } else if (one.skipped) {
            passed = stages.slice(0, -1); // all but the training
            end = ["skipped"];
        }
        const way = [...passed.map((name) => `${name}: passed`), ...end].join(" → ");
        return h("li", null, answers.length > 1 ? `Answer ${at + 1}. ${way}` : way);
    });
    return h("ol", { class: "plain" }, ...ways);
}

// Fold links away where they are many.
const folding = (links, count) => (count > 12 ? [h("details", null, h("summary", null, number(count)), ...links)] : links);

const linksTo = (run, ids) => (ids.length ? listOf(ids.map((id) => linkTo(run, id))) : ["none"]);

// Say in which generations a candidate was the elite of which niche; it can move with the bounds.
function nichesHeld(run, one) {
    const spans = [];
    for (const line of run.generations) {
        const niche = line.elites.find(([, id]) => id === one.id)?.[0];
        const last = spans.at(-1);
        if (niche === undefined) continue;
        if (last && last.niche === niche && last.to === line.generation - 1) last.to = line.generation;
        else spans.push({ niche, from: line.generation, to: line.generation });
    }
    const words = spans.map(
        ({ niche, from, to }) => `${placeName(run)} ${niche} after generation ${from === to ? from : `${from} to ${to}`}`,
    );
    return words.join("; ") || "none";
}

function requestOf(run, one) {
    if (one.operator === "baseline") return h("p", null, "The task's baseline; no model was asked for it.");
    if (one.operator === "given") return h("p", null, "A network that was given; no model was asked for it.");
    const fixed = one.operator === "sample" ? "Draw a network at random." : run.crossover;
    const text = one.prompt === null ? fixed : run.instructions[one.prompt].text;
    return h(
        "div",
        null,
        h("h3", null, `Asked for by ${one.prompt === null ? "" : `${one.operator}: `}${instructionOf(run, one)}`),
        h("blockquote", null, text),
        h("p", null, ...temperatureOf(run, one)),
    );
}

// What is known of a temperature: no record has whether a model acted on it, but its makers may have noted that.
function temperatureOf(run, one) {
    const value = number(one.temperature);
    if (one.dropped.includes("temperature"))
        return [`Temperature not sent, because ${run.why_not_sent ?? "the model refuses it"} (${value} was planned).`];
    if (one.carrier !== undefined && one.level === undefined)
        return [`Temperature not sent${carriedBy(run)} (${value} was planned).`];
    if (isByGrammar(run))
        return [`Temperature ${value}${carriedBy(run)}, here a mutation strength: up to four random edits came on top.`];
    const chosen = one.effort ? `effort ${one.effort}` : `“${run.boldness?.[one.level - 1]}”`;
    const carried = one.carrier === undefined ? "" : `${carriedBy(run)}: ${chosen}`;
    return [`Temperature ${value}${carried}.`, ...(run.on_temperature.length ? [" ", h("a", { href: "#temperature-note" }, "A note of the makers says more of temperatures"), "."] : [])];
}

function rejectedOf(one) {
    if (one.rejected === null) return null;
    return h(
        "div",
        null,
        h("h3", null, ...withCode("The reason, and the rejected answer (as its file has it; `tacevo replay` checks it)")),
        h("pre", { tabindex: 0, "aria-label": `rejected answer of ${one.id}` }, one.rejected),
    );
}

function sourceOf(run, one) {
    const source = state.page.sources[one.source];
    if (source === undefined)
        return [null, "train"].includes(one.stage) ? h("p", null, "No source: its file is missing, or was edited.") : null;
    const lines = linesOf(source);
    const code = h("code", null);
    const show = (change) => {
        const rows = change
            ? changedLines(linesOf(state.page.sources[run.byId.get(change.parent).source]), lines, change.kept)
            : lines.map((line) => [" ", line]);
        code.replaceChildren(...rows.map(([sign, line]) => lineOf(sign, line, Boolean(change))));
    };
    const choice = h("select", { id: "source-choice" }, h("option", { value: "" }, "the source"));
    one.changes.forEach((change, place) =>
        choice.append(h("option", { value: place }, `changes since ${change.parent}`)),
    );
    choice.onchange = () => show(one.changes[choice.value]);
    choice.value = one.changes.length ? "0" : "";
    show(one.changes[choice.value]);
    const copy = h("button", { id: "source-copy" }, "Copy it as a file");
    copy.onclick = async () => {
        try {
            await navigator.clipboard.writeText(withImports(source));
            copy.textContent = "Copied";
        } catch {
            // A page over plain HTTP has no clipboard.
            copy.textContent = `Not copied; tacevo show RUN ${one.id} --source prints it`;
        }
    };
    return h(
        "div",
        null,
        h("p", null, h("label", null, "Show ", choice), " ", copy),
        h("pre", { class: "source", tabindex: 0, "aria-label": `source of ${one.id}` }, code),
    );
}

// Return a source with the imports that the sandbox gave it.
const withImports = ({ text, given: [at, imports] }) => text.slice(0, at) + imports + text.slice(at);

// Cut a source into lines of (class, text).
function linesOf({ text, marks }) {
    const lines = [[]];
    let at = 0;
    for (const mark of marks.split(" ").filter(Boolean)) {
        const part = text.slice(at, (at += Number(mark.slice(1))));
        part.split("\n").forEach((piece, place) => {
            if (place) lines.push([]);
            if (piece) lines.at(-1).push([mark[0], piece]);
        });
    }
    return lines;
}

// Put the lines that a parent lost and those that its child gained between those that were kept.
function changedLines(parent, child, kept) {
    const rows = [];
    let [lost, gained] = [0, 0];
    for (const [ofParent, ofChild, count] of [...kept, [parent.length, child.length, 0]]) {
        while (lost < ofParent) rows.push(["−", parent[lost++]]);
        while (gained < ofChild) rows.push(["+", child[gained++]]);
        for (let at = 0; at < count; at++) rows.push([" ", child[gained++]]);
        lost += count;
    }
    return folded(rows);
}

// Leave out lines that are far from every change.
function folded(rows) {
    const near = new Set(rows.flatMap(([sign], at) => (sign === " " ? [] : d3.range(at - CONTEXT, at + CONTEXT + 1))));
    return rows.flatMap((row, at) => {
        if (near.has(at)) return [row];
        return at === 0 || near.has(at - 1) ? [["⋯", []]] : [];
    });
}

const CONTEXT = 4;

const SIGNS = { "−": ["del", "is-lost"], "+": ["ins", "is-gained"], " ": ["span", null], "⋯": ["span", null] };

function lineOf(sign, line, isSigned) {
    const [name, ofSign] = SIGNS[sign];
    const parts = line.map(([kind, text]) => (kind === "t" ? text : h("span", { class: `code-${kind}` }, text)));
    return h(name, { class: `line-of-code ${ofSign ?? ""}` }, isSigned ? `${sign} ` : "", ...parts);
}
