"""Checks a published run or sweep without TacEvo: python examples/independent_reader.py BUNDLE.zip.

It needs Python 3.11 and nothing else. docs/formats.md says what the files hold, which text is under which digest, and
what this cannot find. No code of a candidate runs. The first difference ends it with status 1, and a line that names
member, line and field.
"""

import base64
import collections
import contextlib
import csv
import hashlib
import json
import lzma
import math
import statistics
import struct
import sys
import zipfile

MANIFEST, STORE = "manifest-sha256.txt", "store.jsonl.xz"
SAID = ("text", "model", "stop_reason", "input_tokens", "output_tokens")
FITNESS = {  # the rules that TacEvo has
    "last": lambda losses: losses[-1],
    "lowest": min,
    "mean_of_3": lambda losses: rounded(statistics.fmean(losses[-3:])),
}

Store = collections.namedtuple("Store", ("entries", "asked", "answers"))


class DifferentError(Exception):
    """Something is not what the rest of the file says."""


def canonical(value):
    """Write JSON in the one form that is hashed."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def sha256(data):
    """Hash bytes, or text in UTF-8."""
    return hashlib.sha256(data if isinstance(data, bytes) else data.encode()).hexdigest()


def content_hash(value):
    """Hash JSON."""
    return sha256(canonical(value))


def key_of(kind, request):
    """Return the key of a store's entry."""
    return content_hash({"schema": 1, "kind": kind, "request": request})


def seed_of(*name):
    """Return the seed that a purpose has, such as the run's seed, `study` and 3: 63 bits of a hash."""
    return int(sha256(json.dumps(name))[:32], 16) % 2**63


def tell(text, file=sys.stdout):
    """Print a line, in which no name from a file can begin another one."""
    print("".join(letter if letter.isprintable() else "?" for letter in text), file=file)


def rounded(value):
    """Keep 9 significant digits, as losses and metrics have."""
    return float(f"{value:.9g}")


def expect(got, wanted, *place):
    """Compare two values of JSON, of which 1 and 1.0 are different ones."""
    if type(got) is not type(wanted) or canonical(got) != canonical(wanted):
        words = [canonical(value)[:100] for value in (wanted, got)]
        raise DifferentError(f"{', '.join(place)}: expected {words[0]}; got {words[1]}")


def is_within(part, whole):
    """Answer whether a record says all that another one says; that leaves out what is at its default."""
    if isinstance(part, dict) and isinstance(whole, dict):
        return all(name in whole and is_within(value, whole[name]) for name, value in part.items())
    return canonical(part) == canonical(whole)


@contextlib.contextmanager
def at(*place):
    """Name the place of what lacks a field, has one of another type, or cannot be read at all."""
    try:
        yield
    except DifferentError:
        raise
    except Exception as error:  # whatever a file that anybody may have written makes Python raise
        got = f"{type(error).__name__} {error}"[:100]
        raise DifferentError(f"{', '.join(place)}: expected what docs/formats.md describes; got {got}") from error


def parse(text, *place):
    """Read JSON in which no object has a key twice."""

    def once(pairs):
        if len(dict(pairs)) < len(pairs):
            raise ValueError("a key a second time")
        return dict(pairs)

    with at(*place):
        return json.loads(text.decode(), object_pairs_hook=once)


def read_lines(data, name):
    """Yield the records of a file of lines, each with its place and its text, which is the one text of the record."""
    expect(data.endswith(b"\n"), True, name, "line break at its end")
    for number, text in enumerate(data.decode().removesuffix("\n").split("\n"), 1):
        line, place = parse(text.encode(), name, f"line {number}"), (name, f"line {number}")
        with at(*place):
            if canonical(line) != text or not isinstance(line, dict):
                raise ValueError("no record, or one in another text")
            yield ((*place, line["id"]) if "id" in line else place), line, text


def read_chain(data, name):
    """Read lines of which each has the hash of the line before and its own; return them with their hashes."""
    lines, hashes = [], ["0" * 64]
    for place, line, _ in read_lines(data, name):
        own = line.pop("hash", None)
        expect(content_hash(line), own, *place, "hash")
        expect(line.pop("previous", None), hashes[-1], *place, "previous")
        lines.append((place, line))
        hashes.append(own)
    return lines, hashes[1:]


def read_members(path):
    """Read a zip file whose members are those of its manifest; return them, and the bundle digest."""
    with zipfile.ZipFile(path) as archive:
        for name, times in collections.Counter(archive.namelist()).items():
            expect(times, 1, name, "how often it is there")
        members = {name: archive.read(name) for name in archive.namelist()}
    text = members.pop(MANIFEST, b"").decode(errors="replace")
    listed = {name: digest for digest, _, name in (line.partition("  ") for line in text.splitlines())}
    for name in sorted(listed.keys() | members.keys()):
        expect(sha256(members[name]) if name in members else None, listed.get(name), name, "SHA-256")
    expect(text, "".join(f"{listed[name]}  {name}\n" for name in sorted(listed)), MANIFEST, "text")
    tell(f"{MANIFEST}: {len(members)} members, each with its SHA-256, and no other")
    return members, sha256(text)


def read_store(data):
    """Read the entries of the store by kind and key, and by the hashes that a ledger has of requests and answers."""
    entries, asked, last = {}, {}, ("", "")
    stream = lzma.LZMADecompressor(format=lzma.FORMAT_XZ)
    with at(STORE):
        text = stream.decompress(data)
        expect([stream.eof, len(stream.unused_data)], [True, 0], STORE, "one xz stream, and nothing behind it")
    (place, header, _), *others = read_lines(text, STORE)
    expect(header, {"schema": 1, "entries": len(others)}, *place)
    for place, entry, text in others:
        with at(*place):
            expect(sorted(entry), ["answer", "kind", "request"], *place, "fields")
            kind, request, answer = entry["kind"], entry["request"], entry["answer"]
            expect(last < (kind, text), True, *place, "order")
            last = (kind, text)
            expect((kind, key_of(kind, request)) in entries, False, *place, "request, which stands above")
            entries[kind, key_of(kind, request)] = (request, answer)
            if kind == "completions":
                asked[content_hash(request)] = content_hash({field: answer[field] for field in SAID})
            if kind == "arrays":
                expect(sha256(base64.b64decode(answer["base64"], validate=True)), request["sha256"], *place, "base64")
    tell(f"{STORE}: {len(entries)} entries, in their one order and text")
    return Store(entries, asked, set(asked.values()))


def training_of(line, store, *, kind, source, data, version, seed, place):
    """Compare a line with the training that its key names; return the answer of that entry, None where it failed."""
    expect((kind, line["evaluation"]) in store.entries, True, *place, f"evaluation, which {STORE} has")
    request, answer = store.entries[kind, line["evaluation"]]
    expect(sha256(request["source"]), source, *place, "source, as was trained")
    expect([request["data"], request["version"]], [data["fingerprint"], version], *place, "data and rules, as trained")
    expect(request["seed"], seed_of(*seed), *place, "training seed")
    rejection = answer.get("rejection", {})
    for field in ("stage", "reason"):
        expect(line.get(field), rejection.get(field), *place, field)
    if rejection:
        return None
    training = (answer.get("full") or answer)["training"]
    told = {"predictions": training["predictions_sha256"], "weights": training["weights_sha256"]}
    told |= {"not_deterministic": training.get("not_deterministic", []), "captured": training.get("captured")}
    for field, value in told.items():
        expect(line.get(field, [] if value == [] else None), value, *place, field)
    return answer


def check_candidate(line, header, files, store, *place):
    """Compare a candidate's line with its file, and with what was asked, answered and trained."""
    if line["request"] is not None:
        answers = [*(repair["answer"] for repair in line.get("repairs", [])), line["answer"]]
        expect(store.asked.get(line["request"]), answers[0], *place, f"answer, by its request in {STORE}")
        expect(store.answers.issuperset(answers), True, *place, f"answers, which {STORE} has")
    if line.get("source"):
        expect(sha256(files.get(f"{line['id']}.py", b"")), line["source"], *place, "source, by its file")
    answer, version = None, header.get("rules", {}).get("training", 1)
    if line.get("evaluation"):
        source = line.get("source") or sha256(store.entries["evaluations", line["evaluation"]][0]["source"])
        known = {"kind": "evaluations", "source": source, "data": header["data"], "version": version}
        answer = training_of(line, store, **known, seed=(header["config"]["seed"], "training"), place=place)
    if answer is None:
        expect(line.get("fitness"), None, *place, "fitness, without a training")
        return
    for field in ("train_losses", "validation_losses"):
        expect(line[field], answer["training"][field], *place, field)
    rule = header["config"]["training"].get("fitness", "last")
    if rule in FITNESS:
        expect(line["fitness"], FITNESS[rule](line["validation_losses"]), *place, f"fitness, by the rule {rule}")


def check_run(folder, members, store):
    """Check the members of a run below a folder such as `run/`; return its digest."""
    names = [f"{folder}{name}" for name in ("run.json", "archive.json", "prompts.json", "ledger.jsonl")]
    record, networks, prompts = (parse(members[name], name) for name in names[:3])
    lines, hashes = read_chain(members[names[3]], names[3])
    (_, header), *others = lines
    with at(names[0]):
        expect([header["kind"], header["schema"], record["schema"]], ["run", 1, 1], names[3], "kind and schema")
        task = {field: value for field, value in record["task"].items() if value != []}
        told = {"digest": record["digest"], "data": record["data"], "task": content_hash(task)}
        for field, value in {"digest": hashes[-1], "data": header["data"], "task": header["task"]}.items():
            expect(told[field], value, names[0], field)
        for group, value in header["config"].items():  # of these, names of files and of parts are written otherwise
            said = {"kind": value} if group == "numerics" else value
            known = group == "parts" or is_within(said, record["config"][group])
            expect(known, True, names[0], f"config.{group}, by the ledger's header")
    inside = f"{folder}candidates/"
    files = {name.removeprefix(inside): data for name, data in members.items() if name.startswith(inside)}
    fitness = {}
    for place, line in others:
        with at(*place):
            if line["kind"] == "candidate":
                check_candidate(line, header, files, store, *place)
                fitness[line["id"]] = line.get("fitness")
    place, last = (names[1], "elites"), lines[-1][1]
    with at(*place):
        for field in ("coverage", "qd_score", "bounds"):
            expect(networks[field], last[field], names[1], field)
        expect(prompts["coverage"], last["prompt_coverage"], names[2], "coverage")
        for one in networks["elites"]:
            expect(one["fitness"], fitness.get(one["id"]), *place, one["id"], "fitness")
        held = {str(one["niche"]): {"name": one["id"], "objective": -one["fitness"]} for one in networks["elites"]}
        expect(content_hash(held), last["archive"], *place)
        fields = ("prompt", "temperature", "inserted", "curiosity")
        held = {str(one["niche"]): {field: one[field] for field in fields} for one in prompts["trials"]}
        expect(content_hash(held), last["prompt_archive"], names[2], "trials")
    trained = sum(value is not None for value in fitness.values())
    tell(f"{names[3]}: {len(lines)} lines in a chain; {trained} of {len(fitness)} candidates trained, as in the store")
    for study in sorted({name.rpartition("/")[0] for name in members if name.startswith(f"{folder}studies/")}):
        check_study(study, members, store, header, hashes)
    return hashes[-1]


def check_study(folder, members, store, run, hashes):
    """Check a study, a noise run or a choice: chain, scores by the store, medians by the table of them."""
    place, name = (f"{folder}/study.json",), f"{folder}/scores.jsonl"
    record = parse(members[place[0]], *place)
    lines, chain = read_chain(members[name], name)
    (_, header), *rows = lines
    with at(*place):
        expect([header["kind"], header["schema"], record["schema"]], ["study", 2, 2], name, "kind and schema")
        expect(record["digest"], chain[-1], *place, "digest")
        for field, value in header.items():
            expect(field == "kind" or is_within(value, record[field]), True, *place, f"{field}, by {name}")
        expect(header["run"] in hashes, True, *place, "run, which is this one")
        wanted = [[one["name"], one["id"], seed] for one in header["networks"] for seed in range(header["seeds"])]
        expect([[row.get(part) for part in ("network", "id", "seed")] for _, row in rows], wanted, name, "rows")
        sources = {one["name"]: one["source"] for one in header["networks"]}
        metric = {"regression": "mse", "classification": "accuracy"}[header["data"]["kind"]]
    known = {"kind": "studies" if header.get("terms") else "evaluations", "version": header.get("rules", 2)}
    what = "study" if header.get("terms") else "choice" if header.get("validated") else "noise"
    values = collections.defaultdict(list)
    for place, row in rows:
        with at(*place):
            source, seed = sources[row["network"]], [header["seed"], what, row["seed"]][: 2 if what == "choice" else 3]
            answer = training_of(row, store, **known, source=source, data=header["data"], seed=seed, place=place)
            recipe = store.entries[known["kind"], row["evaluation"]][0]["recipe"]
            expect(recipe, header["recipe"], *place, "recipe, as trained")
            if answer is not None:
                check_score(row, answer, header, run, store, *place)
                values[row["network"]].append(row["metrics"].get(metric, row["validation_loss"]))
    medians = {network: rounded(statistics.median(each)) for network, each in values.items()}
    end = folder.rpartition("/")[2]
    for table in (one for one in members if one.endswith((f"_{end}.csv", f"{end}/scores.csv")) and "/scores" in one):
        said = {row["network"]: row.get("median") for row in csv.DictReader(members[table].decode().splitlines())}
        for network, value in medians.items():
            expect(said.get(network), str(value), table, network, "median")
    tell(f"{name}: {len(rows)} scores as in the store; digest {chain[-1]}")
    tell(f"  medians: {', '.join(f'{network} {value:.3g}' for network, value in medians.items())}")


def check_score(row, answer, header, run, store, *place):
    """Compare a score with its training and, where the bundle has the test predictions, with these."""
    full = answer.get("full", {})
    losses = (full or answer)["training"]["validation_losses"]
    is_lowest = bool(full or header.get("validated"))  # a noise run has the fitness of the search
    rule = "lowest" if is_lowest else run["config"]["training"].get("fitness", "last")
    loss = FITNESS[rule](losses)
    told = {"validation_loss": loss, "epoch": losses.index(loss) + 1 if rule == "lowest" else len(losses)}
    told |= {"metrics": full.get("metrics", {}), "confusion": full.get("confusion"), "kept": full.get("kept")}
    for field, value in told.items():
        expect(row.get(field), value, *place, field)
    metrics, counts, kept = row["metrics"], row["confusion"], row.get("kept")
    if counts is not None:
        right = sum(one[number] for number, one in enumerate(counts))
        expect(metrics["accuracy"], rounded(right / sum(map(sum, counts))), *place, "metrics.accuracy")
    if kept is None or place[0].startswith("sweep/"):  # the bundle of a sweep leaves them out
        return
    images, outputs = header["data"]["counts"][2], header["data"]["outputs"]
    labelled = ("<f4", [images, outputs]) if counts is None else ("<i8", [images])
    arrays = []
    for name, (dtype, shape) in {"predictions": ("<f4", [images, outputs]), "labels": labelled}.items():
        key = key_of("arrays", {"sha256": kept[name], "dtype": dtype, "shape": shape})
        data = base64.b64decode(store.entries["arrays", key][1]["base64"])
        arrays.append(struct.unpack(f"<{math.prod(shape)}{'f' if dtype == '<f4' else 'q'}", data))
    predicted, labels = arrays
    if counts is None:
        squares = math.fsum((one - other) ** 2 for one, other in zip(predicted, labels, strict=True))
        expect(metrics["mse"], rounded(squares / len(labels)), *place, "metrics.mse")
        return
    found, loss = [[0] * outputs for _ in range(outputs)], []
    for image, label in enumerate(labels):
        logits = predicted[image * outputs :][:outputs]
        found[label][logits.index(max(logits))] += 1
        loss.append(math.log(math.fsum(math.exp(one - max(logits)) for one in logits)) + max(logits) - logits[label])
    expect(counts, found, *place, "confusion")
    expect(metrics["cross_entropy"], rounded(math.fsum(loss) / images), *place, "metrics.cross_entropy")


def check(path):
    """Check a file, and print what was checked, the bundle digest, and the digest to cite."""
    members, bundle = read_members(path)
    store = read_store(members[STORE])
    for request, answer in (entry for (kind, _), entry in store.entries.items() if kind == "candidates"):
        expect(request["file"] in members, False, STORE, "a file of its own")  # a sweep has its candidates' there
        members[request["file"]] = answer["text"].encode()
    if "run/run.json" in members:
        digest = check_run("run/", members, store)
    else:
        sweep = parse(members["sweep/sweep.json"], "sweep/sweep.json")
        expect(sweep["schema"], 1, "sweep/sweep.json", "schema")
        names = [job["name"] for job in sweep["jobs"]]
        there = {name.split("/")[1] for name in members if name.endswith("/run.json")}
        expect(sorted(names), sorted(there), "sweep/sweep.json", "jobs")
        for job in sweep["jobs"]:
            run = parse(members[f"sweep/{job['name']}/run.json"], job["name"])
            expect(job["seed"], run["config"]["seed"], "sweep/sweep.json", job["name"], "seed")
        digest = content_hash({name: check_run(f"sweep/{name}/", members, store) for name in names})
    tell(f"bundle digest: {bundle}")
    tell(f"digest: {digest}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    try:
        with at(sys.argv[1]):
            check(sys.argv[1])
    except DifferentError as problem:
        tell(f"different: {problem}", sys.stderr)
        sys.exit(1)
