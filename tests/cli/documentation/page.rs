//! Takes the command lines out of a page of Markdown, with what its comments tell the tests to do.
//!
//! Blocks fenced as `sh` are scripts of a shell; of those fenced as `console`, lines that begin with `$ ` are, and the others
//! are what is said, among other lines; a line that ends with `…` goes on. Comments, which readers do not see, tell what readers need not:
//!
//! | comment | means |
//! |---|---|
//! | `<!-- test: setup` … `-->` | a script that is run there: it makes files that a reader has |
//! | `<!-- test: replace` … `-->` | lines `long => short`: from there on, every line is run with `short` for `long` |
//! | `<!-- test: not run, REASON -->` | the next block is not run |
//! | `<!-- test: fails -->` | the last command of the next block fails |

/// Something that a page asks for, in its order.
#[derive(Debug, PartialEq)]
pub(super) enum Step {
    /// Makes what a reader has.
    Setup(String),
    /// From here on, lines are run with the second text for the first.
    Replace(String, String),
    /// A block of command lines.
    Block(Block),
}

/// A fenced block.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Block {
    /// The line of the page that it begins in, from 1.
    pub(super) line: usize,
    /// What the shell reads.
    pub(super) script: String,
    /// What is said then, line by line, as far as the page shows it.
    pub(super) said: Vec<String>,
    /// Why it is not run.
    pub(super) not_run: Option<String>,
    /// Whether it ends with a command that fails.
    pub(super) fails: bool,
}

const COMMENT: &str = "<!-- test: ";

/// Reads a page; panics naming the line of what it does not understand.
pub(super) fn steps(page: &str) -> Vec<Step> {
    let mut steps = Vec::new();
    let mut next = Block::default();
    let mut lines = page.lines().enumerate();
    while let Some((index, line)) = lines.next() {
        let number = index + 1;
        if let Some(comment) = line.trim().strip_prefix(COMMENT) {
            let is_whole = comment.ends_with("-->");
            let (kind, rest) = told(comment);
            let mut below: Vec<&str> = Vec::new();
            if !is_whole {
                below.extend(lines.by_ref().map(|(_, line)| line).take_while(|line| line.trim() != "-->"));
            }
            match (kind, is_whole) {
                ("setup", false) => steps.push(Step::Setup(below.join("\n"))),
                ("replace", false) => steps.extend(below.iter().map(|line| replacement(line, number))),
                ("not run", true) if !rest.is_empty() => next.not_run = Some(rest.to_owned()),
                ("fails", true) => next.fails = true,
                _ => panic!("line {number}: {line:?} is none of the comments for tests"),
            }
        } else if let Some(language) = line.trim_start().strip_prefix("```").filter(|rest| !rest.is_empty()) {
            let indent = line.len() - line.trim_start().len();
            let body =
                lines.by_ref().map(|(_, line)| line).take_while(|line| !line.trim_start().starts_with("```"));
            let body: Vec<&str> = body.map(|line| line.get(indent..).unwrap_or("")).collect();
            let (script, said) = match language.split(',').next() {
                Some("sh") => (body.join("\n"), Vec::new()),
                Some("console") => conversation(&body),
                _ => continue,
            };
            let Block { not_run, fails, .. } = std::mem::take(&mut next);
            steps.push(Step::Block(Block { line: number, script, said, not_run, fails }));
        }
    }
    assert_eq!(next, Block::default(), "a comment for tests has no block behind it");
    steps
}

/// What a comment is, and what it says beside.
fn told(comment: &str) -> (&str, &str) {
    let text = comment.trim_end_matches("-->").trim();
    text.split_once(", ").unwrap_or((text, ""))
}

fn replacement(line: &str, number: usize) -> Step {
    let (long, short) =
        line.split_once(" => ").unwrap_or_else(|| panic!("below line {number}: {line:?} has no ` => `"));
    Step::Replace(long.trim().to_owned(), short.trim().to_owned())
}

/// The commands of a session, and what is said in it.
fn conversation(lines: &[&str]) -> (String, Vec<String>) {
    let (mut script, mut said) = (Vec::new(), Vec::new());
    let mut goes_on = false;
    for line in lines {
        let command = line.strip_prefix("$ ").or(goes_on.then_some(*line));
        goes_on = command.is_some_and(|command| command.ends_with('\\'));
        match command {
            Some(command) => script.push(command.to_owned()),
            None => said.push((*line).to_owned()),
        }
    }
    (script.join("\n"), said)
}

/// The calls of `udc` in a script, as far as the flags go: without comments, pipes and redirections, the names of variables for
/// their values.
pub(super) fn calls(script: &str) -> Vec<String> {
    let joined = script.replace("\\\n", " ").replace('$', "");
    let without_comment = |line: &str| {
        let at = line.find(" #").unwrap_or(line.len());
        if line.trim_start().starts_with('#') { String::new() } else { line[..at].to_owned() }
    };
    let lines: Vec<String> = joined.lines().map(without_comment).collect();
    let commands =
        lines.iter().flat_map(|line| line.split("&&")).flat_map(|part| part.split(['|', ';', '>']));
    commands.map(str::trim).filter(|part| part.starts_with("udc ")).map(str::to_owned).collect()
}

#[test]
fn pages_become_steps() {
    let page = "text\n<!-- test: setup\nmake it\n-->\n<!-- test: replace\n--count 1000 => --count 2\n-->\n\
                ```sh\nudc a \\\n  -b  # note\n```\n```toml\nx = 1\n```\n<!-- test: not run, takes weeks -->\n\
                <!-- test: fails -->\n```console\n$ udc c | wc\nsaid\n```\n";
    let script = "udc a \\\n  -b  # note".to_owned();
    let first = Block { line: 8, script, ..Block::default() };
    let second = Block {
        line: 17,
        script: "udc c | wc".to_owned(),
        said: vec!["said".to_owned()],
        not_run: Some("takes weeks".to_owned()),
        fails: true,
    };
    let expected = [
        Step::Setup("make it".to_owned()),
        Step::Replace("--count 1000".to_owned(), "--count 2".to_owned()),
        Step::Block(first),
        Step::Block(second),
    ];
    assert_eq!(steps(page), expected);
    assert_eq!(
        calls("udc a \\\n  -b  # note\nx=1; udc c | wc && udc d > e"),
        ["udc a    -b", "udc c", "udc d"]
    );
}

#[test]
#[should_panic(expected = "none of the comments")]
fn a_comment_that_is_misspelt_is_no_comment() {
    steps("<!-- test: replcae\na => b\n-->\n");
}
