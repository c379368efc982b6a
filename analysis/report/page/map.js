// The archive map: the niches of the network archive and what held them after the chosen generation.

const COLOURS = {
    fitness: { name: "validation loss", value: (one) => one.fitness, isReversed: true },
    generation: { name: "generation", value: (one) => one.generation, isLinear: true },
    parameters: { name: "parameters", value: (one) => one.parameters },
    flops: { name: "FLOPs", value: (one) => one.flops },
};

const MAP = { width: 560, height: 500, left: 84, right: 20, top: 12, bottom: 44 };

// How far a mark stays within the frame.
const EDGE = 4;
const mapX = d3.scaleLinear([0, 1], [MAP.left, MAP.width - MAP.right]);
const mapY = d3.scaleLinear([0, 1], [MAP.height - MAP.bottom, MAP.top]);

const cellPath = (corners) => `M${corners.map(([x, y]) => `${mapX(x)},${mapY(y)}`).join("L")}Z`;

// Where a network stands: clipped to the ends of its axes, as the archive clips it; in the middle of an axis without
// extent.
function placeOnMap(point, extents) {
    const places = point.map((value, axis) => {
        const [low, high] = extents[axis];
        return high > low ? Math.min(Math.max((value - low) / (high - low), 0), 1) : 0.5;
    });
    return [places[0], places[1] ?? 0.5];
}

// Return the colour of a candidate, and of a value. One scale holds for all generations, from the least to the greatest
// value of the last one; an elite beyond it has the colour of its end, as has one that failed later and has no loss.
function colouring(run, choice) {
    const { value, isReversed, isLinear } = COLOURS[choice];
    let [low, high] = d3.extent(run.generations.at(-1).elites, ([, id]) => value(run.byId.get(id)));
    if (low === undefined) [low, high] = [0, 1];
    const isLog = !isLinear && low > 0 && high > low;
    const place = isLog
        ? d3.scaleLog([low, high], [0, 1])
        : d3.scaleLinear([low, high === low ? low + 1 : high], [0, 1]);
    place.clamp(true);
    const colour = (one) => d3.interpolateCividis(isReversed ? 1 - place(one) : place(one));
    return { of: (candidate) => colour(value(candidate) ?? Infinity), colour, at: (part) => place.invert(part), low, high, isLog };
}

function drawMap() {
    const run = state.run;
    const slider = byId("generation");
    slider.max = run.generations.length - 1;
    slider.value = state.generation;
    byId("map-drawing").replaceChildren();
    const svg = d3.select("#map-drawing").append("svg").attr("viewBox", `0 0 ${MAP.width} ${MAP.height}`);
    svg.attr("role", "group").attr("aria-label", "Elites on the archive map. Arrow keys go to the nearest one, PageDown to the next.");
    svg.append("rect")
        .attr("class", "empty")
        .attr("x", MAP.left)
        .attr("y", MAP.top)
        .attr("width", MAP.width - MAP.left - MAP.right)
        .attr("height", MAP.height - MAP.top - MAP.bottom);
    svg.append("g")
        .attr("class", "cells")
        .selectAll("path")
        .data(run.cells)
        .join("path")
        .attr("class", "empty")
        .attr("d", cellPath);
    byId("map-legend").replaceChildren(mapLegend(run));
    svg.append("g").attr("class", "axes").attr("aria-hidden", "true");
    svg.append("g").attr("class", "elites");
    svg.append("g").attr("class", "points"); // above the cells, of which another one would hide a point at its edge
    svg.append("g").attr("class", "lost"); // above the elites, whose cells would hide its dashes
    fillMap();
}

// What each mark of the map is; without niches an elite is a disc.
function mapLegend(run) {
    const shape = (kind, inner) => {
        const svg = smallDrawing(14).attr("viewBox", "0 0 14 14");
        const group = svg.append("g").attr("class", kind).attr("transform", "translate(7,7)");
        inner(group);
        return svg.node();
    };
    const symbol = (kind, size, name) => (group) => group.append("path").attr("class", name).attr("d", d3.symbol(kind, size)());
    const cell = symbol(run.cells.length ? d3.symbolSquare : d3.symbolCircle, 90, "cell");
    const hasEmptied = run.generations.some(
        (line, at) => at && run.generations[at - 1].elites.some(([niche]) => !line.elites.some(([other]) => other === niche)),
    );
    return legend([
        [run.cells.length ? "an elite, in its niche" : "an elite", shape("", symbol(d3.symbolCircle, 22, "point"))],
        ["the best elite", shape("", symbol(d3.symbolStar, 50, "point is-best"))],
        ["new in this generation", shape("is-new", cell)],
        ["chosen: its panel is shown", shape("is-selected", cell)],
        ...(hasEmptied && run.cells.length ? [["emptied in this generation", shape("emptied", symbol(d3.symbolSquare, 90, ""))]] : []),
    ]);
}

// Draw what depends on the generation or the choice of colours.
function fillMap() {
    const run = state.run;
    const line = run.generations[state.generation];
    const previous = state.generation ? run.generations[state.generation - 1] : { elites: [], extents: line.extents };
    const before = new Map(previous.elites);
    const now = new Map(line.elites);
    const held = new Set(before.values());
    const isNew = ([, id]) => !held.has(id); // an old elite that only changed its niche is not
    const lost = [...before.keys()].filter((niche) => !now.has(niche));
    const scale = colouring(run, state.colour);
    const best = d3.least(line.elites, ([, id]) => run.byId.get(id).fitness)?.[1];
    const svg = d3.select("#map-drawing svg");
    svg.select(".lost")
        .selectAll("path")
        .data(run.cells.length ? lost : [])
        .join("path")
        .attr("d", (niche) => cellPath(run.cells[niche]));
    const links = svg
        .select(".elites")
        .selectAll("a")
        .data(line.elites, ([niche]) => niche)
        .join((entered) => {
            const link = entered.append("a");
            link.append("path").attr("class", "cell");
            return link;
        });
    const placeOf = ([, id]) => placeOnMap(run.byId.get(id).point, line.extents);
    links.attr("href", ([, id]) => addressOf(run, id));
    links.attr("aria-label", ([niche, id]) => eliteWords(run, niche, id));
    links
        .classed("is-new", isNew)
        .classed("is-selected", ([, id]) => id === state.selected);
    const rank = (elite) => (elite[1] === state.selected ? 2 : Number(isNew(elite)));
    links.sort((a, b) => rank(a) - rank(b)); // an edge that says something lies above its neighbours'
    const toPlace = (elite) => {
        const [x, y] = placeOf(elite); // the ends of the axes are elites' own places: a mark on the frame is drawn inside
        const [left, top] = [Math.max(mapX(x), MAP.left + EDGE), Math.max(mapY(y), MAP.top + EDGE)];
        return `translate(${Math.min(left, MAP.width - MAP.right - EDGE)},${Math.min(top, MAP.height - MAP.bottom - EDGE)})`;
    };
    const disc = d3.symbol(d3.symbolCircle, 260)(); // for an archive without niches
    links
        .select(".cell")
        .attr("d", ([niche]) => (run.cells.length ? cellPath(run.cells[niche]) : disc))
        .attr("transform", run.cells.length ? null : toPlace)
        .attr("fill", ([, id]) => scale.of(run.byId.get(id)));
    svg.select(".points")
        .selectAll("path")
        .data(line.elites)
        .join("path")
        .attr("class", ([, id]) => (id === best ? "point is-best" : "point"))
        .attr("d", ([, id]) => (id === best ? d3.symbol(d3.symbolStar, 90)() : d3.symbol(d3.symbolCircle, 22)()))
        .attr("transform", toPlace);
    const say = ([niche, id]) => (byId("map-readout").textContent = eliteWords(run, niche, id));
    links.on("pointerenter focus", (_, elite) => say(elite));
    const nodes = links.nodes();
    const first = nodes.find((node) => d3.select(node).datum()[1] === (state.selected ?? best)) ?? nodes[0];
    withArrowKeys(
        nodes,
        (node) => placeOf(d3.select(node).datum()).map((part, axis) => 500 * (axis ? 1 - part : part)),
        first,
    );
    drawMapAxes(svg, run, line);
    const changed = line.elites.filter(isNew).length;
    const holds = `${now.size} of ${run.places} ${placeName(run)}s held`;
    const isMoved = run.cells.length > 0 && String(previous.extents) !== String(line.extents);
    const emptied = lost.length ? `; ${lost.length} emptied${isMoved ? " because the bounds moved" : ""}` : "";
    byId("generation-words").textContent =
        `Generation ${line.generation}: ${holds}, ${changed} by a new elite${emptied}.`;
    byId("generation").setAttribute("aria-valuetext", byId("generation-words").textContent);
    const bar = scale.high > scale.low ? colourBar(scale.colour, scale.at, scale.low, scale.high) : "";
    byId("map-colours").replaceChildren(
        `${COLOURS[state.colour].name} of the elite${scale.isLog ? " (logarithmic scale)" : ""}, from the least to the greatest of the last generation`,
        bar,
    );
}

function drawMapAxes(svg, run, line) {
    const axes = svg.select(".axes");
    axes.selectAll("*").remove();
    const [x, y] = line.extents.map(([low, high]) => d3.scaleLinear([low, high > low ? high : low + 1], [0, 1]));
    const bottom = MAP.height - MAP.bottom;
    for (const tick of x ? x.ticks(6) : []) {
        axes.append("line")
            .attr("x1", mapX(x(tick)))
            .attr("x2", mapX(x(tick)))
            .attr("y1", bottom)
            .attr("y2", bottom + 5);
        axes.append("text")
            .attr("x", mapX(x(tick)))
            .attr("y", bottom + 17)
            .attr("text-anchor", "middle")
            .text(shortly(tick));
    }
    for (const tick of y ? y.ticks(6) : []) {
        axes.append("line")
            .attr("x1", MAP.left - 5)
            .attr("x2", MAP.left)
            .attr("y1", mapY(y(tick)))
            .attr("y2", mapY(y(tick)));
        axes.append("text")
            .attr("x", MAP.left - 8)
            .attr("y", mapY(y(tick)))
            .attr("dy", "0.32em")
            .attr("text-anchor", "end")
            .text(shortly(tick));
    }
    const [across, up] = run.axes.map((name, axis) => [name, ...(run.directions[axis] ?? [])]);
    drawAxisName(axes.append("g"), across, [mapX(0), mapX(1)], [MAP.height - 6, MAP.height - 6]);
    // Upright there is less room, so what stands at the ends is nearer to the axis than its name.
    if (up) drawAxisName(axes.append("g").attr("transform", "rotate(-90)"), up, [-mapY(0), -mapY(1)], [12, 29]);
}

// Write the name of an axis in its middle, and at its ends what low and high values mean, where that has words.
function drawAxisName(group, [name, low, high], [start, end], [y, besideY]) {
    const write = (text, x, at, anchor) =>
        group.append("text").attr("x", x).attr("y", at).attr("text-anchor", anchor).text(text);
    write(name, (start + end) / 2, y, "middle");
    if (!low) return;
    write(`← ${low}`, start, besideY, "start");
    write(`${high} →`, end, besideY, "end");
}

function eliteWords(run, niche, id) {
    const one = run.byId.get(id);
    const sizes = `${counted(one.parameters, "parameter")}, ${counted(one.flops, "FLOP")}`;
    return `${id}, ${placeName(run)} ${niche}: ${lossWords(one)}, ${sizes}, by ${instructionOf(run, one)}`;
}
