// How the search went, generation by generation.

function drawDynamics() {
    const run = state.run;
    const lines = run.generations;
    const of = (name) => lines.map((line) => line[name]);
    const ends = of("skipped").some(Boolean) ? ["trained", "skipped"] : ["trained"];
    const figures = [
        lineChart({
            caption:
                "Fitness: the best and the median elite of the archive, and the median of the generation's own networks.",
            yName: "validation loss",
            scaleOf: lossScale,
            series: [
                { name: "best", values: of("best") },
                { name: "archive median", values: of("archive_median") },
                { name: "generation median", values: of("generation_median") },
            ],
        }),
        lineChart({
            caption: "Coverage of both archives.",
            yName: "coverage",
            format: percent,
            series: [
                { name: "networks", values: of("coverage") },
                { name: "prompts", values: of("prompt_coverage") },
            ],
        }),
        lineChart({
            caption: "QD-score of the network archive.",
            yName: "QD-score",
            series: [{ name: "QD-score", values: of("qd_score") }],
        }),
        stackedBars({
            caption: "First answers: trained, skipped where there is a surrogate, or the stage that rejected them.",
            yName: "candidates",
            names: [...ends, ...Object.keys(lines[0].rejected).map((stage) => `rejected at ${stage}`)],
            rows: lines.map((line) => [...ends.map((name) => line[name] ?? 0), ...Object.values(line.rejected)]),
        }),
        lineChart({
            caption: `Temperature${carriedBy(run)} of each generation.`,
            yName: "temperature",
            series: [{ name: "T", values: of("temperature") }],
        }),
        ...(run.prompt_cells.length ? [promptMap(run)] : []),
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

// The prompt archive over instruction and temperature; a cell without a child in the network archive is striped.
function promptMap(run) {
    const caption = `The prompt archive over instruction and temperature${carriedBy(run)}, coloured by curiosity.`;
    const x = d3.scaleLinear([0, 1], [INSET.left, WIDTH - INSET.right]);
    const y = d3.scaleLinear([0, 1], [HEIGHT - INSET.bottom, INSET.top]);
    const shape = (niche) => `M${run.prompt_cells[niche].map(([a, b]) => `${x(a)},${y(b)}`).join("L")}Z`;
    const held = run.trials.length;
    const svg = drawing(`${caption} ${held} of ${run.prompt_cells.length} niches are held.`);
    const last = Math.max(run.instructions.length - 1, 1);
    const beyond = new Set(run.unreachable);
    run.prompt_cells.forEach((_, niche) => {
        const cell = svg
            .append("path")
            .attr("d", shape(niche))
            .attr("class", beyond.has(niche) ? "unreachable" : "empty");
        cell.append("title").text(beyond.has(niche) ? "No trial could reach this niche." : "empty");
    });
    const colour = d3.scaleSequential([0.5, 2], d3.interpolateCividis);
    for (const trial of run.trials) {
        const words = `${trial.instruction} at temperature ${number(trial.temperature)}: curiosity ${number(trial.curiosity)}, child ${trial.inserted ? "inserted" : "not inserted"}`;
        svg.append("path")
            .attr("class", "cell")
            .attr("d", shape(trial.niche))
            .attr("fill", colour(trial.curiosity))
            .append("title")
            .text(words);
        const [left, top] = [x(trial.prompt / last), y(trial.temperature)];
        const kind = trial.inserted ? d3.symbolCircle : d3.symbolTimes;
        svg.append("path")
            .attr("class", trial.inserted ? "point" : "point is-cross")
            .attr("transform", `translate(${left},${top})`)
            .attr("d", d3.symbol(kind, 22)());
    }
    const toPrompt = (tick) => x(tick / last);
    const xTicks = d3
        .range(run.instructions.length)
        .map((tick) => [tick, String(tick)])
        .filter((_, at) => at % Math.ceil(last / 10) === 0);
    frame(svg, toPrompt, y, {
        xName: "instruction (index in the library)",
        yName: "temperature",
        xTicks,
        yTicks: ticksOf(y, 5, shortly),
    });
    const words =
        "A disc is a trial whose child entered the network archive, a cross one whose child did not; grey dashes bound niches that no trial could reach.";
    return h(
        "figure",
        null,
        h("figcaption", null, caption),
        svg.node(),
        colourBar(colour, (part) => 0.5 + 1.5 * part, 0.5, 2),
        h("p", { class: "note" }, words),
    );
}
