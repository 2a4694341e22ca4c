#include "surg_core/files/document.hpp"

#include <yaml.h>

#include <algorithm>
#include <cctype>
#include <limits>
#include <optional>
#include <vector>

#include "files/text_file.hpp"

namespace surg {
namespace {

using files::refuse;

// A configuration is a page of text. The bounds keep nested nonsense from taking the machine down
// before the schema is asked.
constexpr std::uintmax_t kMaxBytes = 1 << 20;
constexpr std::size_t kMaxDepth = 16;
constexpr std::size_t kMaxKeys = 10000;  // nested aliases could otherwise unfold without end

int line_of(const yaml_node_t& node) { return static_cast<int>(node.start_mark.line) + 1; }

std::string text_of(const yaml_node_t& node) {
  return {reinterpret_cast<const char*>(node.data.scalar.value), node.data.scalar.length};
}

/// libyaml's parser and its documents, each deleted with its object.
struct Parser {
  Parser() { yaml_parser_initialize(&raw); }
  ~Parser() { yaml_parser_delete(&raw); }
  Parser(const Parser&) = delete;
  Parser& operator=(const Parser&) = delete;
  yaml_parser_t raw{};
};

struct Parsed {
  Parsed() = default;
  ~Parsed() { yaml_document_delete(&raw); }
  Parsed(const Parsed&) = delete;
  Parsed& operator=(const Parsed&) = delete;
  yaml_document_t raw{};
};

void parse_next(Parser& parser, Parsed& document, const std::string& file) {
  if (yaml_parser_load(&parser.raw, &document.raw)) return;
  const std::string problem = parser.raw.problem ? parser.raw.problem : "out of memory";
  if (problem.find("UTF-8") != std::string::npos) refuse(file, 0, "is not UTF-8 text: " + problem);
  const bool placed = parser.raw.error != YAML_READER_ERROR;
  refuse(file, placed ? static_cast<int>(parser.raw.problem_mark.line) + 1 : 0,
         "is not YAML: " + problem);
}

/// The one document of a text.
void parse_only(const std::string& text, const std::string& file, Parsed& document) {
  Parser parser;
  yaml_parser_set_encoding(&parser.raw, YAML_UTF8_ENCODING);
  yaml_parser_set_input_string(&parser.raw, reinterpret_cast<const unsigned char*>(text.data()),
                               text.size());
  parse_next(parser, document, file);
  Parsed second;
  parse_next(parser, second, file);
  if (const yaml_node_t* root = yaml_document_get_root_node(&second.raw)) {
    refuse(file, line_of(*root), "is not YAML: holds several documents: keep one");
  }
}

/// A plain scalar as a number: decimal, or YAML's .inf and .nan.
std::optional<double> as_number(const std::string& text) {
  if (text == ".nan" || text == ".NaN" || text == ".NAN") {
    return std::numeric_limits<double>::quiet_NaN();
  }
  const bool sign = !text.empty() && (text[0] == '-' || text[0] == '+');
  const std::string word = text.substr(sign);
  if (word == ".inf" || word == ".Inf" || word == ".INF") {
    const double infinite = std::numeric_limits<double>::infinity();
    return text[0] == '-' ? -infinite : infinite;
  }
  return files::decimal(text);
}

/// Flattens one text.
class Flattening {
 public:
  Flattening(const std::string& text, const std::string& file) {
    out_.file = file;
    parse_only(text, file, parsed_);
  }

  Document run() {
    const yaml_node_t* root = yaml_document_get_root_node(&parsed_.raw);
    if (!root || root->type != YAML_MAPPING_NODE) {
      refuse(out_.file, root ? line_of(*root) : 0,
             "is not a mapping; 'key: value' lines are needed");
    }
    flatten(*root, "");
    return std::move(out_);
  }

 private:
  const yaml_node_t& at(int index) { return *yaml_document_get_node(&parsed_.raw, index); }

  void flatten(const yaml_node_t& node, const std::string& prefix) {
    if (above_.size() == kMaxDepth) refuse(out_.file, line_of(node), "nested too deeply");
    above_.push_back(&node);
    for (const yaml_node_pair_t* pair = node.data.mapping.pairs.start;
         pair != node.data.mapping.pairs.top; ++pair) {
      const yaml_node_t& word = at(pair->key);
      const std::string name = word.type == YAML_SCALAR_NODE ? text_of(word) : "";
      add(prefix + name, name, line_of(word), at(pair->value));
    }
    above_.pop_back();
  }

  void add(const std::string& key, const std::string& name, int line, const yaml_node_t& value) {
    const auto fail = [&](const std::string& what) { refuse(out_.file, line, key + ": " + what); };
    if (name.empty() || name.find('.') != std::string::npos) {
      fail("a key must be a text without dots; write nested keys instead");
    }
    if (out_.lines.count(key)) {
      fail("is said twice; first in line " + std::to_string(out_.lines[key]));
    }
    if (out_.lines.size() >= kMaxKeys) fail("more than " + std::to_string(kMaxKeys) + " keys");
    out_.lines[key] = line;
    if (value.type == YAML_MAPPING_NODE) {
      if (std::count(above_.begin(), above_.end(), &value)) fail("contains itself");
      flatten(value, key + ".");
    } else if (value.type == YAML_SEQUENCE_NODE) {
      out_.values[key] = list(value, line, key);
    } else {
      out_.values[key] = scalar(value, line, key);
    }
  }

  Value list(const yaml_node_t& node, int line, const std::string& key) {
    std::vector<double> numbers;
    std::vector<std::string> texts;
    const auto& items = node.data.sequence.items;
    const auto size = static_cast<std::size_t>(items.top - items.start);
    for (const int* item = items.start; item != items.top; ++item) {
      const yaml_node_t& part = at(*item);
      const Value value = part.type == YAML_SCALAR_NODE ? scalar(part, line, key) : Value(false);
      if (const double* number = std::get_if<double>(&value)) numbers.push_back(*number);
      if (const std::string* text = std::get_if<std::string>(&value)) texts.push_back(*text);
    }
    if (numbers.size() == size) return numbers;
    if (texts.size() == size) return texts;
    refuse(out_.file, line, key + ": a list may hold numbers or texts, all of one kind");
  }

  Value scalar(const yaml_node_t& node, int line, const std::string& key) {
    const std::string text = text_of(node);
    // Quoted or a block: a text, whatever it looks like.
    if (node.data.scalar.style != YAML_PLAIN_SCALAR_STYLE) return text;
    std::string lower = text;
    std::transform(lower.begin(), lower.end(), lower.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    if (text.empty() || text == "~" || text == "null" || text == "Null" || text == "NULL") {
      refuse(out_.file, line, key + ": is empty; a value is needed");
    }
    if (lower == "true" || lower == "false") return lower == "true";
    if (const std::optional<double> number = as_number(text)) return *number;
    return text;
  }

  Parsed parsed_;
  Document out_;
  std::vector<const yaml_node_t*> above_;  // of the present node, for aliases that go in a ring
};

}  // namespace

Document load_document(const std::string& path) {
  return parse_document(files::read_bytes(path, kMaxBytes, "configuration"), path);
}

Document parse_document(const std::string& text, const std::string& file) {
  return Flattening(text, file).run();
}

}  // namespace surg
