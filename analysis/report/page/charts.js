// Figures in SVG: lines over generations, dots with intervals, bars. A dash or a marker repeats what a colour says.

const DASHES = [null, "6 3", "2 3", "8 3 2 3", "4 2"];

const WIDTH = 440;
const HEIGHT = 240;
const INSET = { left: 64, right: 20, top: 10, bottom: 36 };

// Okabe and Ito's colours, as classes of the style.
const colourClass = (place) => `hue${place % 8}`;

const dashOf = (place) => DASHES[place % DASHES.length];

// The most marks that have their names beside them; more would lie on each other.
const NAMED = 8;

function drawing(words, height = HEIGHT, width = WIDTH) {
    return d3.create("svg").attr("viewBox", `0 0 ${width} ${height}`).attr("role", "img").attr("aria-label", words);
}

// Return a scale of losses: logarithmic from a factor of ten on, as in the figures of a paper.
function lossScale(values, range) {
    const [low, high] = d3.extent(values);
    return low > 0 && high / low >= 10
        ? d3.scaleLog([low / 1.1, high * 1.1], range)
        : d3.scaleLinear(low === high ? [low - 0.5, high + 0.5] : [low, high], range).nice();
}

const scaleFromZero = (values, range) =>
    d3.scaleLinear([Math.min(0, d3.min(values)), d3.max(values) || 1], range).nice();

// Return the ticks of a scale as (value, text); of a logarithmic one those that begin with 1, or with 1, 2 and 5.
function ticksOf(scale, count, format) {
    const all = scale.ticks(count);
    const beginning = (digits) => all.filter((tick) => digits.includes(tick.toExponential(0)[0]));
    const few = scale.base ? [beginning("1"), beginning("125"), all].find((some) => some.length > 2) : all;
    return (few ?? all).map((tick) => [tick, format(tick)]);
}

const shortly = (value) => (value !== 0 && Math.abs(value) < 1e-3 ? d3.format(".0e")(value) : d3.format(",~r")(value));

// Draw both axes with their names; `ticks` are (value, text).
function frame(svg, x, y, { xName, yName, xTicks, yTicks, height = HEIGHT }) {
    const axes = svg.append("g").attr("class", "axes").attr("aria-hidden", "true");
    const across = axes
        .selectAll(null)
        .data(xTicks)
        .join("g")
        .attr("transform", ([tick]) => `translate(${x(tick)},0)`);
    across
        .append("line")
        .attr("y1", height - INSET.bottom)
        .attr("y2", height - INSET.bottom + 4);
    across
        .append("text")
        .attr("y", height - INSET.bottom + 15)
        .attr("text-anchor", "middle")
        .text(([, text]) => text);
    const up = axes
        .selectAll(null)
        .data(yTicks)
        .join("g")
        .attr("transform", ([tick]) => `translate(0,${y(tick)})`);
    up.append("line")
        .attr("class", "grid")
        .attr("x1", INSET.left)
        .attr("x2", WIDTH - INSET.right);
    up.append("text")
        .attr("x", INSET.left - 6)
        .attr("dy", "0.32em")
        .attr("text-anchor", "end")
        .text(([, text]) => text);
    const middle = (INSET.left + WIDTH - INSET.right) / 2;
    axes.append("text")
        .attr("x", middle)
        .attr("y", height - 4)
        .attr("text-anchor", "middle")
        .text(xName);
    const turned = `translate(11,${(INSET.top + height - INSET.bottom) / 2}) rotate(-90)`;
    axes.append("text").attr("transform", turned).attr("text-anchor", "middle").text(yName);
}

const wholeTicks = (scale) =>
    scale
        .ticks(8)
        .filter(Number.isInteger)
        .map((tick) => [tick, String(tick)]);

// entries: (name, mark)
function legend(entries) {
    return h("ul", { class: "legend" }, ...entries.map(([name, mark]) => h("li", null, mark, name)));
}

const smallDrawing = (width) =>
    drawing("", 10, width).attr("aria-hidden", "true").attr("role", null).attr("class", "mark");

function recordMark() {
    const svg = smallDrawing(12);
    svg.append("g").attr("class", "estimate").attr("transform", "translate(6,5)").append("line").attr("x1", -4).attr("x2", 4);
    return svg.node();
}

function levelMark() {
    const svg = smallDrawing(30);
    svg.append("line").attr("class", "level").attr("x1", 1).attr("x2", 29).attr("y1", 5).attr("y2", 5);
    return svg.node();
}

function diamondMark() {
    const svg = smallDrawing(12);
    const group = svg.append("g").attr("class", "estimate").attr("transform", "translate(6,5)");
    group.append("path").attr("d", d3.symbol(d3.symbolDiamond, 30)());
    return svg.node();
}

function lineMark(place) {
    const svg = smallDrawing(30);
    const line = svg
        .append("line")
        .attr("class", `line ${colourClass(place)}`)
        .attr("stroke-dasharray", dashOf(place));
    line.attr("x1", 1).attr("x2", 29).attr("y1", 5).attr("y2", 5);
    return svg.node();
}

// Draw lines over generations, below each other in a legend; a value of null leaves a gap.
// series: {name, values: one a generation, low and high: ends of a band}
// levels: {name, value}, level lines; marks: {name, at, from, to}, a diamond at `to`, joined with `from`
function lineChart({
    caption,
    yName,
    series,
    format = number,
    tickFormat = shortly,
    scaleOf,
    xName = "generation",
    from = 0,
    levels = [],
    marks = [],
}) {
    const values = [
        ...series.flatMap((one) => [one.values, one.low ?? [], one.high ?? []].flat()),
        ...levels.map((one) => one.value),
        ...marks.flatMap((one) => [one.from, one.to]),
    ].filter((value) => value !== null);
    if (values.length === 0) return h("figure", null, h("figcaption", null, caption), h("p", null, "No values."));
    const length = d3.max(series, (one) => one.values.length);
    const x = d3.scaleLinear([from, Math.max(from + length - 1, from + 1)], [INSET.left, WIDTH - INSET.right]);
    const y = (scaleOf ?? scaleFromZero)(values, [HEIGHT - INSET.bottom, INSET.top]);
    const told = [
        ...series.map((one) => `${one.name}: ${format(one.values.at(-1))} at the end`),
        ...levels.map((one) => `${one.name}: ${format(one.value)}`),
        ...marks.map((one) => `${one.name}: ${format(one.from)} on record, ${format(one.to)} re-estimated`),
    ];
    const svg = drawing(`${caption} ${told.join("; ")}`);
    frame(svg, x, y, { xName, yName, xTicks: wholeTicks(x), yTicks: ticksOf(y, 5, tickFormat) });
    for (const { value } of levels) {
        svg.append("line")
            .attr("class", "level")
            .attr("x1", x(from))
            .attr("x2", WIDTH - INSET.right)
            .attr("y1", y(value))
            .attr("y2", y(value));
    }
    const isThere = (value) => value !== null;
    const places = d3.range(length);
    series.forEach((one, place) => {
        if (one.low) {
            const area = d3
                .area()
                .x((at) => x(from + at))
                .y0((at) => y(one.low[at]))
                .y1((at) => y(one.high[at]));
            svg.append("path")
                .attr("class", `band ${colourClass(place)}`)
                .attr("d", area.defined((at) => isThere(one.low[at]))(places));
        }
        const line = d3
            .line()
            .x((_, at) => x(from + at))
            .y(y)
            .defined(isThere);
        svg.append("path")
            .attr("class", `line ${colourClass(place)}`)
            .attr("d", line(one.values))
            .attr("stroke-dasharray", dashOf(place));
        if (one.values.length === 1 && isThere(one.values[0])) {
            svg.append("circle")
                .attr("class", `dot ${colourClass(place)}`)
                .attr("r", 3)
                .attr("cx", x(from))
                .attr("cy", y(one.values[0]));
        }
    });
    marks.forEach((one, place) => {
        const same = marks.filter((other) => other.at === one.at);
        const aside = 6 * (same.indexOf(one) - (same.length - 1) / 2); // beside each other within a generation
        const group = svg.append("g").attr("class", "estimate").attr("transform", `translate(${x(one.at) + aside},0)`);
        group.append("line").attr("y1", y(one.from)).attr("y2", y(one.to));
        group.append("line").attr("x1", -4).attr("x2", 4).attr("y1", y(one.from)).attr("y2", y(one.from));
        group.append("path").attr("transform", `translate(0,${y(one.to)})`).attr("d", d3.symbol(d3.symbolDiamond, 44)());
        if (marks.length <= NAMED) {
            // Side by side, one name is to the left and one to the right; at the ends of the axis there is one side.
            const isLeft = one.at > from + 0.8 * length || (one.at > from && same.indexOf(one) < (same.length - 1) / 2);
            const label = group.append("text").attr("x", isLeft ? -6 : 6).attr("y", y(one.to)).attr("dy", "0.32em");
            label.attr("text-anchor", isLeft ? "end" : "start").text(one.name);
        }
        group.append("title").text(told[series.length + levels.length + place]);
    });
    const readout = h("p", { class: "readout" }, "\u00a0");
    const cursor = svg
        .append("line")
        .attr("class", "cursor")
        .attr("visibility", "hidden")
        .attr("y1", INSET.top)
        .attr("y2", HEIGHT - INSET.bottom);
    svg.on("pointermove", (event) => {
        const at = Math.min(length - 1, Math.max(0, Math.round(x.invert(d3.pointer(event)[0])) - from));
        cursor
            .attr("x1", x(from + at))
            .attr("x2", x(from + at))
            .attr("visibility", "visible");
        const words = series.map((one) => `${one.name} ${format(one.values[at] ?? null)}`).join("; ");
        readout.textContent = `${xName} ${from + at}: ${words}`;
    });
    svg.on("pointerleave", () => {
        cursor.attr("visibility", "hidden");
        readout.textContent = "\u00a0";
    });
    const entries = [
        ...series.map((one, place) => [one.name, lineMark(place)]),
        ...levels.map((one) => [`${one.name} ${format(one.value)}`, levelMark()]),
        ...(marks.length
            ? [
                  ["a network's median with other seeds", diamondMark()],
                  ["its fitness on record", recordMark()],
              ]
            : []),
    ];
    const names = entries.length > 1 ? [legend(entries)] : [];
    const valueOf = (one, at) => {
        const band = one.low && isThere(one.low[at]) ? ` (${format(one.low[at])} to ${format(one.high[at])})` : "";
        return `${format(one.values[at] ?? null)}${band}`;
    };
    const numbers = tableOf({
        caption: "The numbers",
        label: caption,
        columns: [xName, ...series.map((one) => one.name)],
        numeric: [true, ...series.map(() => true)],
        rows: places.map((at) => [String(from + at), ...series.map((one) => valueOf(one, at))]),
        notes: [],
    });
    const estimates = marks.length ? [h("ul", { class: "words" }, ...told.slice(-marks.length).map((one) => h("li", null, one)))] : [];
    return h("figure", null, h("figcaption", null, caption), svg.node(), readout, ...names, ...estimates, numbers);
}

// Draw what became of the answers of every generation as bars on each other.
function stackedBars({ caption, yName, names, rows }) {
    const x = d3.scaleBand(d3.range(rows.length), [INSET.left, WIDTH - INSET.right]).padding(0.15);
    const y = d3.scaleLinear([0, d3.max(rows, (row) => d3.sum(row)) || 1], [HEIGHT - INSET.bottom, INSET.top]).nice();
    const totals = names.map((name, place) => `${name}: ${d3.sum(rows, (row) => row[place])}`).join("; ");
    const svg = drawing(`${caption} In all, ${totals}`);
    const step = Math.ceil(rows.length / 12);
    const xTicks = d3.range(0, rows.length, step).map((tick) => [tick, String(tick)]);
    const middle = (tick) => x(tick) + x.bandwidth() / 2;
    frame(svg, middle, y, { xName: "generation", yName, xTicks, yTicks: ticksOf(y, 5, shortly) });
    rows.forEach((row, at) => {
        let below = 0;
        row.forEach((count, place) => {
            const bar = svg
                .append("rect")
                .attr("class", `bar ${colourClass(place)}`)
                .attr("x", x(at))
                .attr("y", y(below + count));
            bar.attr("width", x.bandwidth()).attr("height", y(below) - y(below + count));
            bar.append("title").text(`generation ${at}: ${count} ${names[place]}`);
            below += count;
        });
    });
    const square = (place) => {
        const mark = smallDrawing(12);
        mark.append("rect")
            .attr("class", `bar ${colourClass(place)}`)
            .attr("width", 10)
            .attr("height", 10);
        return mark.node();
    };
    return h("figure", null, h("figcaption", null, caption), svg.node(), legend(names.map((name, place) => [name, square(place)])));
}

// Draw rows with points on one scale, a line from `low` to `high`, a tick at `middle`, and words at the end.
// rows: {name, points, low, high, middle, words}
function dotRows({ caption, xName, rows, format = shortly, say = number, scaleOf }) {
    const [left, step] = [182, 26];
    const height = rows.length * step + INSET.bottom + INSET.top;
    const values = rows.flatMap((row) =>
        [...row.points, row.low, row.high, row.middle].filter((value) => value != null),
    );
    if (values.length === 0) return h("figure", null, h("figcaption", null, caption), h("p", null, "No values."));
    const x = (scaleOf ?? scaleFromZero)(values, [left, WIDTH - INSET.right]);
    const said = rows.map((row) => `${row.name}: ${row.words ?? say(row.middle)}`).join("; ");
    const svg = drawing(`${caption} ${said}`, height);
    const axes = svg.append("g").attr("class", "axes").attr("aria-hidden", "true");
    for (const [tick, text] of ticksOf(x, 5, format)) {
        const at = axes.append("g").attr("transform", `translate(${x(tick)},0)`);
        at.append("line")
            .attr("class", "grid")
            .attr("y1", INSET.top)
            .attr("y2", height - INSET.bottom);
        at.append("text")
            .attr("y", height - INSET.bottom + 15)
            .attr("text-anchor", "middle")
            .text(text);
    }
    const middle = (left + WIDTH - INSET.right) / 2;
    axes.append("text")
        .attr("x", middle)
        .attr("y", height - 4)
        .attr("text-anchor", "middle")
        .text(xName);
    rows.forEach((row, place) => {
        const y = INSET.top + step * (place + 0.5);
        const group = svg.append("g").attr("class", "row");
        const name = row.name.length > 28 ? `${row.name.slice(0, 27)}…` : row.name;
        const label = group
            .append("text")
            .attr("x", left - 8)
            .attr("y", y)
            .attr("dy", "0.32em")
            .attr("text-anchor", "end");
        label.text(name).append("title").text(row.name);
        if (row.low != null) {
            group
                .append("line")
                .attr("class", "interval")
                .attr("x1", x(row.low))
                .attr("x2", x(row.high))
                .attr("y1", y)
                .attr("y2", y);
        }
        row.points.forEach((value, at) => {
            const aside = row.points.length > 1 ? ((at * 7) % 5) * 3 - 6 : 0; // beside each other, and the same every time
            const dot = group
                .append("circle")
                .attr("class", "dot hue1")
                .attr("cx", x(value))
                .attr("cy", y + aside)
                .attr("r", 2.6);
            dot.append("title").text(`${row.name}: ${say(value)}`);
        });
        if (row.middle != null) {
            group
                .append("line")
                .attr("class", "median")
                .attr("x1", x(row.middle))
                .attr("x2", x(row.middle))
                .attr("y1", y - 9)
                .attr("y2", y + 9);
        }
    });
    const words = rows.filter((row) => row.words).map((row) => h("li", null, `${row.name}: ${row.words}`));
    const list = words.length ? [h("ul", { class: "words" }, ...words)] : [];
    return h("figure", null, h("figcaption", null, caption), svg.node(), ...list);
}

// A bar of a colour scale with its ends; steps are few, and all of them visible.
function colourBar(colour, scale, low, high) {
    const svg = drawing(`colours from ${number(low)} to ${number(high)}`, 34, 320).attr("class", "colours");
    d3.range(32).forEach((at) => {
        const value = scale(at / 31);
        svg.append("rect")
            .attr("x", at * 10)
            .attr("width", 10.5)
            .attr("height", 14)
            .attr("fill", colour(value));
    });
    const ends = [
        [0, "start", low],
        [160, "middle", scale(0.5)],
        [320, "end", high],
    ];
    for (const [x, anchor, value] of ends) {
        svg.append("text")
            .attr("x", x)
            .attr("y", 28)
            .attr("text-anchor", anchor)
            .text(number(Number(value.toPrecision(3))));
    }
    return svg.node();
}
