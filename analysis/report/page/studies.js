// Studies of a run and arms of a sweep, where there are any; sections of parts; and all tables.

function drawStudies() {
    const { studies } = state.run;
    showPanel("studies", studies.length > 0);
    byId("studies-body").replaceChildren(...studies.map(studyOf));
}

function studyOf(study) {
    const format = study.is_share ? percent : number;
    const rows = study.networks.map((one) => ({
        name: one.name,
        points: one.values,
        middle: d3.median(one.values),
        words: `median ${format(d3.median(one.values))}${one.verdict ? `; ${one.verdict}` : ""}`,
    }));
    const better = study.lower_is_better ? "less is better" : "more is better";
    const caption = `Test ${study.metric} of every training seed (${better}); the bar is the median.`;
    const figures = [
        dotRows({
            caption,
            xName: `test ${study.metric}`,
            rows,
            format: study.is_share ? tickPercent : shortly,
            say: format,
            scaleOf: study.lower_is_better ? lossScale : tight,
        }),
    ];
    for (const one of study.networks) {
        if (one.confusion) figures.push(confusion(study, one));
    }
    return h(
        "section",
        null,
        h("h3", null, `Study ${study.name}`),
        h("div", { class: "figures" }, ...figures),
        ...study.tables.map(tableOf),
    );
}

const tight = (values, range) => d3.scaleLinear(d3.extent(values), range).nice();

// Test images by true class (rows) and predicted class; shades repeat the numbers.
function confusion(study, one) {
    const head = h(
        "tr",
        null,
        h("th", null, "true \\ predicted"),
        ...study.names.map((name) => h("th", { scope: "col" }, name)),
    );
    const rows = one.confusion.map((row, at) => {
        const cells = row.map((count) => {
            const share = count / (d3.sum(row) || 1);
            const cell = h("td", { class: "number" }, String(count));
            cell.style.backgroundColor = d3.interpolateBlues(0.9 * share);
            cell.style.color = share > 0.5 ? "white" : "black";
            return cell;
        });
        return h("tr", null, h("th", { scope: "row" }, study.names[at]), ...cells);
    });
    const table = h(
        "table",
        { class: "confusion" },
        h("caption", null, `${one.name}: test images at its median seed.`),
        h("thead", null, head),
        h("tbody", null, ...rows),
    );
    return h(
        "div",
        { class: "scroll", tabindex: 0, role: "region", "aria-label": `confusion matrix of ${one.name}` },
        table,
    );
}

function drawSweep() {
    const { sweep, runs } = state.page;
    const choice = byId("run-choice");
    choice.replaceChildren(...runs.map((run, place) => h("option", { value: place }, run.name)));
    choice.value = runs.indexOf(state.run);
    showPanel("arms", Boolean(sweep));
    if (!sweep) return;
    const names = Object.keys(sweep.arms[0].bands);
    const bands = names.map((name) => {
        const series = sweep.arms.map((arm) => ({
            name: arm.name,
            ...arm.bands[name],
            values: arm.bands[name].median,
        }));
        const scaleOf = name === "best fitness" ? lossScale : undefined;
        return lineChart({
            caption: `${name} by generation: median over seeds, band between the quartiles.`,
            yName: name,
            series,
            scaleOf,
            ...(sweep.shares.includes(name) ? { format: percent, tickFormat: tickPercent } : {}),
        });
    });
    const ends = Object.keys(sweep.arms[0].ends).map((name) => {
        const rows = sweep.arms.map((arm) => {
            const values = arm.ends[name].map(([, value]) => value);
            return { name: arm.name, points: values, middle: d3.median(values) };
        });
        const scaleOf = name === "best fitness" ? lossScale : tight;
        return dotRows({
            caption: `${name} at the end: points are seeds, the bar is the median.`,
            xName: name,
            rows,
            scaleOf,
            ...(sweep.shares.includes(name) ? { format: tickPercent, say: percent } : {}),
        });
    });
    byId("arms-figures").replaceChildren(...bands, ...ends);
    byId("arms-tables").replaceChildren(...sweep.tables.map(tableOf));
    byId("arms-sections").replaceChildren(...sweep.sections.map(sectionOf));
}

// What an installed part adds: text, images and tables, of which nothing is markup.
function sectionOf(section) {
    const figures = section.figures.map((one) =>
        h("figure", null, h("img", { src: one.image, alt: one.caption }), h("figcaption", null, one.caption)),
    );
    return h(
        "section",
        { class: "part" },
        h("h3", null, section.title),
        ...section.sentences.map((sentence) => h("p", null, sentence)),
        ...(figures.length > 0 ? [h("div", { class: "figures" }, ...figures)] : []),
        ...section.tables.map(tableOf),
        h("p", { class: "note" }, `By ${section.by}.`),
    );
}

function tableOf(table) {
    const kind = (place) => (table.numeric[place] ? "number" : null);
    const head = table.columns.map((name, place) => h("th", { scope: "col", class: kind(place) }, name));
    const rows = table.rows.map((row) =>
        h("tr", null, ...row.map((text, place) => h("td", { class: kind(place) }, text))),
    );
    const body = h("table", null, h("thead", null, h("tr", null, ...head)), h("tbody", null, ...rows));
    const region = h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": table.label ?? table.caption }, body);
    const notes = table.notes.map((note) => h("p", { class: "note" }, ...withCode(note)));
    const heard = table.label ? { "aria-label": `${table.caption}: ${table.label}` } : null; // of which figure
    return h("details", null, h("summary", heard, ...withCode(table.caption)), region, ...notes);
}
