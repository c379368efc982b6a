// How the search went, generation by generation.

// What a network that was trained again has on record, and with other seeds.
function estimatesOf(run) {
    return run.candidates
        .filter((one) => one.id in run.again && one.fitness !== null)
        .map((one) => ({ name: one.id, at: one.generation, from: one.fitness, to: run.again[one.id] }));
}

function drawDynamics() {
    const run = state.run;
    const lines = run.generations;
    const of = (name) => lines.map((line) => line[name]);
    const baseline = run.candidates[0]?.fitness ?? null;
    const estimates = estimatesOf(run);
    const reach = run.prompt_niches - run.unreachable.length;
    const hasPrompts = reach > 0;
    const ofReach = of("prompt_coverage").map((share) => (share * run.prompt_niches) / reach);
    const figures = [
        lineChart({
            caption: "Fitness: the best and the median elite of the archive, and the median of the generation's own networks.",
            yName: "validation loss",
            scaleOf: lossScale,
            series: [
                { name: "best", values: of("best") },
                { name: "archive median", values: of("archive_median") },
                { name: "generation median", values: of("generation_median") },
            ],
            levels: baseline === null ? [] : [{ name: "baseline", value: baseline }],
            marks: estimates,
        }),
        lineChart({
            caption: hasPrompts
                ? `Coverage of both archives. Prompts: of the ${reach} niches that the temperature rule could reach; of all ${
                      run.prompt_niches
                  }, as tables count them, ${percent(of("prompt_coverage").at(-1))} are held at the end.`
                : "Coverage of the network archive.",
            yName: "coverage",
            format: percent,
            tickFormat: tickPercent,
            series: [
                { name: "networks", values: of("coverage") },
                ...(hasPrompts ? [{ name: "prompts, of those in reach", values: ofReach }] : []),
            ],
        }),
        lineChart({
            caption: "QD-score of the network archive.",
            yName: "QD-score",
            series: [{ name: "QD-score", values: of("qd_score") }],
        }),
        ...answers(lines),
        temperatures(run, of("temperature")),
        ...(hasPrompts ? [promptMap(run)] : []),
        yields(
            "Children of each instruction that entered the network archive, with 95 % intervals.",
            run.by_instruction,
        ),
        yields(
            `The same by the temperature${carriedBy(run)} of the request${isByGrammar(run) ? ", which is a mutation strength of the grammar" : ""}.`,
            run.by_temperature,
        ),
        ...(of("tokens").some(Boolean)
            ? [spending("Tokens of each generation, in and out.", "tokens", of("tokens"))]
            : []),
        ...(of("usd").some(Boolean) ? [spending("Cost of each generation, in US dollars.", "USD", of("usd"))] : []),
    ];
    byId("dynamics-figures").replaceChildren(...figures);
}

// What became of first answers: bars of what there is; where all were trained, a sentence above the figures says so.
function answers(lines) {
    const stages = Object.keys(lines[0]?.rejected ?? {}).filter((stage) => lines.some((line) => line.rejected[stage]));
    const isSkipping = lines.some((line) => line.skipped);
    const all = counted(d3.sum(lines, (line) => line.trained), "candidate");
    const isWhole = stages.length === 0 && !isSkipping;
    byId("dynamics-words").textContent = isWhole ? `All ${all} were trained, the baseline among them: none was rejected.` : "";
    if (isWhole) return [];
    const ends = isSkipping ? ["trained", "skipped"] : ["trained"];
    const bars = stackedBars({
        caption: `First answers: ${ends.join(", ")}${stages.length ? ", or the stage that rejected them" : ""}.`,
        yName: "candidates",
        names: [...ends, ...stages.map((stage) => `rejected at ${stage}`)],
        rows: lines.map((line) => [...ends.map((name) => line[name] ?? 0), ...stages.map((stage) => line.rejected[stage])]),
    });
    return [bars];
}

// The temperature that the rule gave each generation, what it is here, and what is known of its effect.
function temperatures(run, values) {
    const chart = lineChart({
        caption: `Temperature${carriedBy(run)} of each generation.`,
        yName: "temperature",
        series: [{ name: "T", values }],
    });
    const asked = run.candidates.filter((one) => one.temperature !== null);
    const unsent = asked.filter((one) => one.dropped.includes("temperature")).length;
    const carrier = run.settings.temperature?.carrier;
    let words = "The rule gives each generation a sampling temperature for its requests: at a higher one, answers to one question differ more.";
    if (isByGrammar(run)) words = "The grammar takes it as a mutation strength: at a higher one, it makes more random edits beside those that it is asked for.";
    else if (carrier === "none") words = "It was planned, and sent to no model.";
    else if (carrier !== undefined) words = `It is not sent as a number: it chooses one of several ${carrier === "effort" ? "efforts" : "sentences"}.`;
    if (unsent) words += ` ${unsent === asked.length ? "It was not sent" : `In ${unsent} of ${asked.length} requests it was not sent`}: ${run.why_not_sent ?? "the model refuses it"}.`;
    chart.append(h("p", { class: "note" }, words));
    if (run.on_temperature.length) {
        const note = run.on_temperature.map((paragraph) => h("blockquote", null, paragraph));
        chart.append(h("div", { id: "temperature-note", class: "note" }, "The makers' note:", ...note));
    }
    return chart;
}

const spending = (caption, name, values) => lineChart({ caption, yName: name, series: [{ name, values }] });

function yields(caption, found) {
    const rows = found
        .filter((one) => one.tried)
        .map((one) => ({
            name: `${one.name} (${one.inserted} of ${one.tried})`,
            points: [],
            low: one.rate_low,
            high: one.rate_high,
            middle: one.rate,
        }));
    return dotRows({ caption, xName: "inserted / tried", rows });
}

// The prompt archive, a row for each instruction over the temperature, cut into the niches that it meets.
function promptMap(run) {
    const caption = `The prompt archive over instruction and temperature${carriedBy(run)}, coloured by curiosity: how much a trial taught.`;
    const [left, step] = [150, 18];
    const height = INSET.top + step * run.prompt_rows.length + INSET.bottom;
    const x = d3.scaleLinear([0, 1], [left, WIDTH - INSET.right]);
    const y = (row) => INSET.top + step * row;
    const trials = new Map(run.trials.map((trial) => [trial.niche, trial]));
    const beyond = new Set(run.unreachable);
    const svg = drawing(`${caption} ${trials.size} of ${run.prompt_niches} niches are held.`, height);
    const colour = d3.scaleSequential([0.5, 2], (part) => d3.interpolatePurples(0.15 + 0.85 * part)); // not the losses' own
    const wordsOf = (trial) =>
        `${run.instructions[trial.prompt].id} at temperature ${number(trial.temperature)}: curiosity ${number(trial.curiosity)}, child ${trial.inserted ? "inserted" : "not inserted"}`;
    run.prompt_rows.forEach((pieces, row) => {
        svg.append("text")
            .attr("x", left - 6)
            .attr("y", y(row + 0.5))
            .attr("dy", "0.32em")
            .attr("text-anchor", "end")
            .text(run.instructions[row].id.replaceAll("_", " "));
        for (const [niche, low, high] of pieces) {
            const trial = trials.get(niche);
            const piece = svg
                .append("rect")
                .attr("class", trial ? "cell" : beyond.has(niche) ? "unreachable" : "empty")
                .attr("x", x(low))
                .attr("width", x(high) - x(low))
                .attr("y", y(row) + 1)
                .attr("height", step - 2);
            if (trial) piece.attr("fill", colour(trial.curiosity));
            const empty = beyond.has(niche) ? "No trial could reach this niche." : "empty";
            piece.append("title").text(trial ? wordsOf(trial) : empty);
        }
    });
    for (const trial of run.trials) {
        svg.append("path")
            .attr("class", trial.inserted ? "trial" : "trial is-cross")
            .attr("transform", `translate(${x(trial.temperature)},${y(trial.prompt + 0.5)})`)
            .attr("d", d3.symbol(trial.inserted ? d3.symbolCircle : d3.symbolTimes, 22)());
    }
    frame(svg, x, d3.scaleLinear(), { xName: "temperature", yName: "", xTicks: ticksOf(x, 5, shortly), yTicks: [], height });
    const words = [
        "Curiosity is 1 + 1 / (1 + loss) of a child that entered the network archive, else 0.5. A disc is a trial whose child entered the network archive",
        ...(run.trials.some((trial) => !trial.inserted) ? [", a cross one whose child did not"] : []),
        ...(beyond.size ? ["; grey dashes bound niches that no trial could reach"] : []),
    ].join("");
    return h(
        "figure",
        null,
        h("figcaption", null, caption),
        svg.node(),
        colourBar(colour, (part) => 0.5 + 1.5 * part, 0.5, 2),
        h("p", { class: "note" }, `${words}.`),
    );
}
