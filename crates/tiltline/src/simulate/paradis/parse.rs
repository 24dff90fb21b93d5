//! From the text of a nodal data file to raw nodes, in the units of the file.

use std::collections::HashSet;

use super::{MOST_ARMS, ParadisError, Tag};

/// What the file says.
pub struct RawFile {
    /// `minCoordinates`.
    pub low: [f64; 3],
    /// `maxCoordinates`.
    pub high: [f64; 3],
    /// `burgMag` in m, where given.
    pub burgers_magnitude_m: Option<f64>,
    /// All nodes.
    pub nodes: Vec<RawNode>,
}

/// A node as listed.
pub struct RawNode {
    pub tag: Tag,
    pub position: [f64; 3],
    pub constraint: i64,
    pub arms: Vec<RawArm>,
}

/// An arm as listed.
pub struct RawArm {
    pub neighbour: Tag,
    pub burgers: [f64; 3],
    pub plane: [f64; 3],
}

/// Words of the text with their line numbers; `=`, `[` and `]` are words of their own.
struct Words<'a> {
    words: Vec<(usize, &'a str)>,
    next: usize,
    last_line: usize,
}

impl<'a> Words<'a> {
    fn new(text: &'a str) -> Self {
        let mut words = Vec::new();
        let mut last_line = 1;
        for (number, line) in text.lines().enumerate() {
            last_line = number + 1;
            let line = line.split('#').next().unwrap_or("");
            for part in line.split_whitespace() {
                let mut rest = part;
                while let Some(at) = rest.find(['=', '[', ']']) {
                    if at > 0 {
                        words.push((last_line, &rest[..at]));
                    }
                    words.push((last_line, &rest[at..=at]));
                    rest = &rest[at + 1..];
                }
                if !rest.is_empty() {
                    words.push((last_line, rest));
                }
            }
        }
        Self { words, next: 0, last_line }
    }

    fn peek(&self) -> Option<&'a str> {
        self.words.get(self.next).map(|word| word.1)
    }

    /// Whether the next two words are a name and `=`.
    fn at_parameter(&self) -> bool {
        self.words.get(self.next + 1).is_some_and(|word| word.1 == "=")
    }

    fn line(&self) -> usize {
        self.words.get(self.next).map_or(self.last_line, |word| word.0)
    }

    fn take(&mut self, what: &str) -> Result<&'a str, ParadisError> {
        let line = self.line();
        let word = self.peek().ok_or_else(|| ParadisError::Syntax {
            line,
            problem: format!("the file ends where {what} should follow: it is cut off"),
        })?;
        self.next += 1;
        Ok(word)
    }

    /// A finite number.
    fn number(&mut self, what: &str) -> Result<f64, ParadisError> {
        let line = self.line();
        let word = self.take(what)?;
        match word.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            Ok(_) => {
                Err(ParadisError::Syntax { line, problem: format!("{what} is `{word}`, which is not a finite number") })
            }
            Err(_) => Err(ParadisError::Syntax { line, problem: format!("expected {what}, found `{word}`") }),
        }
    }

    fn integer(&mut self, what: &str) -> Result<i64, ParadisError> {
        let line = self.line();
        let word = self.take(what)?;
        word.parse().map_err(|_| ParadisError::Syntax { line, problem: format!("expected {what}, found `{word}`") })
    }

    fn triple(&mut self, what: &str) -> Result<[f64; 3], ParadisError> {
        Ok([self.number(what)?, self.number(what)?, self.number(what)?])
    }

    fn tag(&mut self, what: &str) -> Result<Tag, ParadisError> {
        let line = self.line();
        let word = self.take(what)?;
        let parts = word.split_once(',').and_then(|(domain, index)| Some((domain.parse().ok()?, index.parse().ok()?)));
        let (domain, index) = parts.ok_or_else(|| ParadisError::Syntax {
            line,
            problem: format!("expected {what} as `domain,index`, found `{word}`"),
        })?;
        Ok(Tag { domain, index })
    }

    /// The values of a parameter: one word, or what stands in brackets.
    fn values(&mut self, name: &str) -> Result<Vec<f64>, ParadisError> {
        if self.peek() != Some("[") {
            return Ok(vec![self.number(name)?]);
        }
        self.next += 1;
        let mut values = Vec::new();
        while self.peek() != Some("]") {
            values.push(self.number(name)?);
        }
        self.next += 1;
        Ok(values)
    }
}

/// Reads the text; the nodes are distinct and as many as the header says.
pub fn parse(text: &str) -> Result<RawFile, ParadisError> {
    let mut words = Words::new(text);
    let (mut low, mut high) = (None, None);
    let (mut version, mut count, mut burgers_magnitude_m) = (None, None, None);
    loop {
        let line = words.line();
        let name = words.take("`nodalData =`")?;
        if words.peek() != Some("=") {
            return Err(ParadisError::Syntax { line, problem: format!("expected `name = value`, found `{name}`") });
        }
        words.next += 1;
        let corner = |values: Vec<f64>| {
            <[f64; 3]>::try_from(values).map_err(|values| ParadisError::Syntax {
                line,
                problem: format!("{name} has {} numbers instead of 3", values.len()),
            })
        };
        let single = |values: Vec<f64>| match values[..] {
            [value] => Ok(value),
            _ => {
                Err(ParadisError::Syntax { line, problem: format!("{name} has {} numbers instead of 1", values.len()) })
            }
        };
        match name {
            "dataFileVersion" => version = Some(single(words.values(name)?)?),
            "numFileSegments" => {
                let found = single(words.values(name)?)?;
                if found != 1.0 {
                    return Err(ParadisError::Segments { found });
                }
            }
            "minCoordinates" => low = Some(corner(words.values(name)?)?),
            "maxCoordinates" => high = Some(corner(words.values(name)?)?),
            "nodeCount" => count = Some(single(words.values(name)?)?),
            "burgMag" => burgers_magnitude_m = Some(single(words.values(name)?)?),
            "nodalData" => break,
            // The rest is about how the simulation was shared out.
            _ => {
                while words.peek().is_some() && !words.at_parameter() {
                    words.next += 1;
                }
            }
        }
    }
    let line = words.line();
    let missing = |name: &str| ParadisError::Syntax { line, problem: format!("there is no `{name}` before nodalData") };
    let version = version.ok_or_else(|| missing("dataFileVersion"))?;
    if version != 4.0 && version != 5.0 {
        return Err(ParadisError::Version { found: version });
    }
    let low = low.ok_or_else(|| missing("minCoordinates"))?;
    let high = high.ok_or_else(|| missing("maxCoordinates"))?;
    let declared = count.ok_or_else(|| missing("nodeCount"))?;
    let nodes = nodes(&mut words)?;
    if declared != nodes.len() as f64 {
        return Err(ParadisError::NodeCount { declared, found: nodes.len() });
    }
    Ok(RawFile { low, high, burgers_magnitude_m, nodes })
}

fn nodes(words: &mut Words) -> Result<Vec<RawNode>, ParadisError> {
    let mut nodes = Vec::new();
    let mut tags = HashSet::new();
    while words.peek().is_some() {
        let line = words.line();
        let tag = words.tag("a node")?;
        if !tags.insert(tag) {
            return Err(ParadisError::Duplicate { line, tag });
        }
        let position = words.triple("a coordinate")?;
        let line = words.line();
        let number = words.integer("the number of arms")?;
        let number =
            usize::try_from(number).ok().filter(|&number| number <= MOST_ARMS).ok_or_else(|| ParadisError::Syntax {
                line,
                problem: format!("node {tag} has {number} arms; 0 to {MOST_ARMS} are possible"),
            })?;
        let constraint = words.integer("a constraint")?;
        let arms = (0..number).map(|_| {
            Ok(RawArm {
                neighbour: words.tag("an arm")?,
                burgers: words.triple("a Burgers vector")?,
                plane: words.triple("a plane normal")?,
            })
        });
        let arms = arms.collect::<Result<_, ParadisError>>()?;
        nodes.push(RawNode { tag, position, constraint, arms });
    }
    Ok(nodes)
}
