// What accuracy costs: every trained candidate by loss and FLOPs, the front, and the hypervolume by generation.

function drawPareto() {
    const { run } = state;
    const volumes = run.generations.map((line) => line.hypervolume);
    const isThere = run.pareto.front.length > 0;
    showPanel("pareto", isThere);
    if (!isThere) return;
    const growth = lineChart({
        caption:
            "Hypervolume: the part of the box between (0, 0) and the baseline's loss with the most FLOPs of any trained candidate that the networks so far dominate.",
        yName: "part of the box",
        format: percent,
        series: [{ name: "hypervolume", values: volumes }],
    });
    byId("pareto-figures").replaceChildren(frontChart(run), growth);
}

function logScale(values, range) {
    const [low, high] = d3.extent(values);
    return low > 0 ? d3.scaleLog([low / 1.1, high * 1.1], range) : lossScale(values, range);
}

// Loss against FLOPs, both logarithmic; a point of the front is a link to its candidate.
function frontChart(run) {
    const caption = "Validation loss and FLOPs of one image; the line joins the networks that no other one beats in both.";
    const { again, front } = run.pareto;
    const candidates = run.candidates
        .map((one) => ({ id: one.id, flops: one.flops, fitness: again[one.id] ?? one.fitness, isAgain: one.id in again }))
        .filter((one) => one.fitness !== null);
    const byName = new Map(candidates.map((one) => [one.id, one]));
    const edge = d3.sort(
        candidates.filter((one) => front.includes(one.id)),
        (one) => one.flops,
    );
    const x = logScale(
        candidates.map((one) => one.flops),
        [INSET.left, WIDTH - INSET.right],
    );
    const y = logScale(
        candidates.map((one) => one.fitness),
        [HEIGHT - INSET.bottom, INSET.top],
    );
    const svg = drawing(caption).attr("role", "group");
    frame(svg, x, y, {
        xName: "FLOPs",
        yName: "validation loss",
        xTicks: ticksOf(x, 4, d3.format("~s")),
        yTicks: ticksOf(y, 5, shortly),
    });
    const words = (one) =>
        `${one.id}: loss ${number(one.fitness)}${one.isAgain ? ", re-estimated" : ""}, ${number(one.flops)} FLOPs`;
    const others = candidates.filter((one) => !front.includes(one.id));
    svg.append("g")
        .selectAll("circle")
        .data(others)
        .join("circle")
        .attr("class", "dot hue7")
        .attr("cx", (one) => x(one.flops))
        .attr("cy", (one) => y(one.fitness))
        .attr("r", 2);
    const step = d3
        .line()
        .curve(d3.curveStepAfter)
        .x((one) => x(one.flops))
        .y((one) => y(one.fitness));
    svg.append("path").attr("class", "line hue0").attr("d", step(edge));
    const links = svg
        .append("g")
        .selectAll("a")
        .data(edge)
        .join("a")
        .attr("href", (one) => addressOf(run, one.id))
        .attr("aria-label", words)
        .attr("transform", (one) => `translate(${x(one.flops)},${y(one.fitness)})`);
    const shapeOf = (one) => (one.isAgain ? d3.symbolDiamond : d3.symbolSquare);
    links
        .append("path")
        .attr("class", "dot hue0")
        .attr("d", (one) => d3.symbol(shapeOf(one), 60)());
    links.append("title").text(words);
    const baseline = byName.get(run.candidates[0].id);
    if (baseline !== undefined) {
        svg.append("path") // above all points, which would hide it
            .attr("class", "point is-baseline")
            .attr("transform", `translate(${x(baseline.flops)},${y(baseline.fitness)})`)
            .attr("d", d3.symbol(d3.symbolTriangle, 110)());
    }
    const place = new Map(edge.map((one) => [one.id, [x(one.flops), y(one.fitness)]]));
    withArrowKeys(links.nodes(), (node) => place.get(d3.select(node).datum().id), links.nodes()[0]);
    const note = [
        "The triangle is the baseline.",
        ...(edge.some((one) => one.isAgain)
            ? ["A diamond was trained again by a study or a noise run, and counts by the median of these losses."]
            : []),
        ...(edge.some((one) => !one.isAgain)
            ? ["A square counts by the fitness by which the search chose, which flatters it: it was not trained again, and may be luck."]
            : []),
    ].join(" ");
    const best = bestOf(run);
    const absent =
        best in again && !front.includes(best)
            ? h("p", null, linkTo(run, best), `, best on record with ${number(run.byId.get(best).fitness)}, is not among them: trained again, it has ${number(again[best])}.`)
            : "";
    const named = edge.map((one) => linkTo(run, one.id));
    return h(
        "figure",
        null,
        h("figcaption", null, caption),
        svg.node(),
        h("p", null, "The front: ", ...listOf(named), "."),
        absent,
        h("p", { class: "note" }, note),
    );
}
