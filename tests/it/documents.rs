//! What the documents tell a reader to type: it is parsed by the programs themselves, as far as can be without running
//! it. Their Rust blocks are doctests, see the end of `src/lib.rs`.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

fn root(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn read(path: &str) -> String {
    fs::read_to_string(root(path)).unwrap_or_else(|problem| panic!("{path}: {problem}"))
}

/// The documents for users, from the repository's root.
fn documents() -> Vec<String> {
    let in_docs = fs::read_dir(root("docs")).expect("docs/");
    let names = in_docs
        .flatten()
        .map(|entry| format!("docs/{}", entry.file_name().to_string_lossy()));
    let mut all: Vec<_> = names.filter(|name| name.ends_with(".md")).collect();
    all.extend(["README.md", "CHANGELOG.md"].map(Into::into));
    all.sort();
    all
}

/// The commands in a document: lines of its shell blocks, and what it quotes.
fn commands(document: &str) -> Vec<Vec<String>> {
    let mut lines = Vec::new();
    for (number, part) in document.split("```").enumerate() {
        if number % 2 == 1 {
            if let Some(block) = part.strip_prefix("sh\n") {
                lines.extend(block.replace("\\\n", " ").lines().map(str::to_owned));
            }
        } else {
            // A quotation may go over a line's end, but not over a paragraph's.
            for paragraph in part.split("\n\n") {
                let quoted = paragraph.split('`').skip(1).step_by(2);
                lines.extend(quoted.map(|quoted| quoted.replace('\n', " ")));
            }
        }
    }
    let words = |line: &String| {
        let line = line.split(" #").next().unwrap_or_default();
        // What follows an ellipsis is the reader's.
        let line = line.split('…').next().unwrap_or_default();
        line.split_whitespace()
            .filter(|word| !matches!(*word, "[" | "]"))
            .skip_while(|word| is_variable(word))
            .map(str::to_owned)
            .collect::<Vec<_>>()
    };
    lines
        .iter()
        .map(words)
        .filter(|words| is_ours(words))
        .collect()
}

fn is_variable(word: &str) -> bool {
    word.split_once('=').is_some_and(|(name, _)| {
        !name.is_empty() && name.chars().all(|c| c.is_ascii_uppercase() || c == '_')
    })
}

/// Whether it is a command, and not a program's name or part of a sentence.
fn is_ours(words: &[String]) -> bool {
    match words.first().map(String::as_str) {
        Some("skyline") => words.len() > 1,
        Some("cargo") => words
            .get(1)
            .is_some_and(|word| word == "run" || word == "install"),
        Some(first) => first.starts_with("scripts/") && first != "scripts/",
        None => false,
    }
}

/// A reader's `T`, `DIR` or `M` as something that parses.
fn filled_in(word: &str) -> &str {
    let is_placeholder = word.chars().all(|c| c.is_ascii_uppercase());
    if is_placeholder { "1" } else { word }
}

/// What is wrong with a command.
fn complaint(words: &[String], manifest: &str) -> Option<String> {
    let (program, rest) = words.split_first()?;
    match program.as_str() {
        "skyline" => wrong_for_skyline(rest),
        "cargo" => wrong_for_cargo(rest, manifest),
        script => wrong_for_script(script, rest),
    }
}

/// An option that no program has, at the end: whoever complains of nothing before it took the others.
const NO_OPTION: &str = "--no-such-option";

fn wrong_for_skyline(arguments: &[String]) -> Option<String> {
    if arguments == ["help"] {
        return None;
    }
    let output = Command::new(env!("CARGO_BIN_EXE_skyline"))
        .args(arguments.iter().map(|word| filled_in(word)))
        .arg(NO_OPTION)
        .output()
        .expect("the command starts");
    let said = String::from_utf8_lossy(&output.stderr);
    let is_taken = output.status.code() == Some(2) && said.contains(NO_OPTION);
    (!is_taken).then(|| said.into_owned())
}

/// The values of an option, whichever way it is written.
fn values<'a>(words: &'a [String], option: &str) -> Option<&'a str> {
    let at = words.iter().position(|word| word == option)?;
    words.get(at + 1).map(String::as_str)
}

fn wrong_for_cargo(words: &[String], manifest: &str) -> Option<String> {
    let (own, passed) = match words.iter().position(|word| word == "--") {
        Some(at) => (&words[..at], &words[at + 1..]),
        None => (words, &[][..]),
    };
    let features = values(own, "--features").unwrap_or_default();
    let features: BTreeSet<_> = features
        .split(',')
        .filter(|name| !name.is_empty())
        .collect();
    let table = manifest.split("[features]").nth(1)?.split("\n[").next()?;
    let is_feature = |name: &&str| {
        table
            .lines()
            .any(|line| line.starts_with(&format!("{name} =")))
    };
    if let Some(unknown) = features.iter().find(|name| !is_feature(name)) {
        return Some(format!("{unknown} is no feature"));
    }
    let Some(example) = values(own, "--example") else {
        return (own.first()? == "run").then(|| "it runs no example".into());
    };
    let source = format!("examples/{example}.rs");
    if !root(&source).exists() {
        return Some(format!("there is no {source}"));
    }
    let entry = manifest
        .split("[[example]]")
        .find(|entry| entry.contains(&format!("name = \"{example}\"")))?;
    let needed = entry
        .split("required-features = [")
        .nth(1)
        .and_then(|rest| rest.split(']').next());
    let needed = needed.unwrap_or_default().split('"').skip(1).step_by(2);
    let is_all = own.iter().any(|word| word == "--all-features");
    let missing: Vec<_> = needed
        .filter(|name| !is_all && !features.contains(name))
        .collect();
    if !missing.is_empty() {
        return Some(format!("it needs the features {missing:?}"));
    }
    // The examples' own options are read by the examples' sources.
    let mut sources = read(&source);
    for entry in fs::read_dir(root("examples/common")).ok()?.flatten() {
        sources += &fs::read_to_string(entry.path()).unwrap_or_default();
    }
    let options = passed.iter().filter_map(|word| word.strip_prefix("--"));
    let unknown: Vec<_> = options
        .filter(|option| !sources.contains(option) && !sources.contains(&option.replace('-', "_")))
        .collect();
    (!unknown.is_empty()).then(|| format!("it has no options {unknown:?}"))
}

fn wrong_for_script(script: &str, arguments: &[String]) -> Option<String> {
    if !root(script).is_file() {
        return Some("there is no such file".into());
    }
    let text = read(script);
    let unknown = arguments
        .iter()
        .find(|word| word.starts_with("--") && !text.contains(word.as_str()));
    if let Some(unknown) = unknown {
        return Some(format!("it has no option {unknown}"));
    }
    // Its argument is a test's name.
    let filter = arguments
        .first()
        .filter(|word| script == "scripts/test.sh" && !word.starts_with('-'))?;
    let module = filter.split("::").next()?;
    let modules = read("tests/main.rs");
    // The beginning of a name stands for all that begin so.
    (!modules.contains(&format!("mod {module}"))).then(|| format!("there are no tests {module}"))
}

#[test]
fn what_the_documents_say_to_type_can_be_typed() {
    let manifest = read("Cargo.toml");
    let mut wrong = Vec::new();
    let mut seen = [0; 3];
    for document in documents() {
        for words in commands(&read(&document)) {
            let kind = ["skyline", "cargo"]
                .iter()
                .position(|name| words[0] == *name);
            seen[kind.unwrap_or(2)] += 1;
            if let Some(complaint) = complaint(&words, &manifest) {
                wrong.push(format!("{document}: {}: {complaint}", words.join(" ")));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    println!(
        "{} commands of skyline, {} of cargo, {} scripts",
        seen[0], seen[1], seen[2]
    );
    assert!(seen[0] > 20 && seen[1] > 3 && seen[2] > 5, "{seen:?}");
}

#[test]
fn what_cannot_be_typed_is_noticed() {
    let manifest = read("Cargo.toml");
    for line in [
        "skyline draw --out p.png",
        "skyline accuracy weather --out report",
        "skyline interior engine.glb --hole 0.005 --out e.glb",
        "skyline workload --path sideways --target-ms 33 --out f.csv",
        "cargo run --example minimal",
        "cargo run --all-features --example maximal",
        "cargo run --all-features --example interior -- --no-such-thing",
        "cargo install --locked --path . --features climb",
        "scripts/paint.sh",
        "scripts/test.sh soft_cases",
    ] {
        let [words] = commands(&format!("see `{line}`"))
            .try_into()
            .expect("one command");
        assert!(complaint(&words, &manifest).is_some(), "{line}");
    }
    let block = "```sh\nskyline accuracy \\\n    all --quick # minutes\n# a remark\nA=1 scripts/test.sh cause\n```";
    let words: Vec<_> = commands(block)
        .iter()
        .map(|words| words.join(" "))
        .collect();
    assert_eq!(
        words,
        ["skyline accuracy all --quick", "scripts/test.sh cause"]
    );
}

#[test]
fn every_document_with_rust_in_it_is_compiled() {
    let library = read("src/lib.rs");
    let with_rust: Vec<_> = documents()
        .into_iter()
        .filter(|document| read(document).contains("```rust"))
        .collect();
    for document in &with_rust {
        assert!(
            library.contains(&format!("\"../{document}\"")),
            "{document} is not among the doctests"
        );
    }
    assert!(with_rust.len() > 4, "{with_rust:?}");
    for document in with_rust {
        assert!(!read(&document).contains("```rust,ignore"), "{document}");
    }
}
