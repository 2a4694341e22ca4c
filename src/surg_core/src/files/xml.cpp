#include "files/xml.hpp"

#include <expat.h>
#include <iconv.h>

#include <cerrno>
#include <memory>
#include <regex>

#include "files/text_file.hpp"

namespace surg::files {
namespace {

constexpr std::uintmax_t kMaxBytes = 64 << 20;
constexpr std::size_t kMaxDepth = 100;
constexpr const char* kUtf8 = "UTF-8";

/// Where an XML declaration states its encoding.
const std::regex kDeclared(R"(^(<\?xml\b[^>]*?\bencoding\s*=\s*["'])([A-Za-z0-9._-]+))");

bool starts(const std::string& text, std::string_view with) {
  return text.compare(0, with.size(), with) == 0;
}

/// The encoding of an XML file: its byte order mark, else how '<' is written, else its declaration.
std::string encoding_of(const std::string& bytes) {
  using namespace std::string_view_literals;
  if (starts(bytes, "\xEF\xBB\xBF")) return kUtf8;
  if (starts(bytes, "\xFF\xFE") || starts(bytes, "\xFE\xFF")) return "UTF-16";
  if (starts(bytes, "<\0"sv)) return "UTF-16LE";
  if (starts(bytes, "\0<"sv)) return "UTF-16BE";
  std::smatch found;
  const std::string head = bytes.substr(0, 200);
  return std::regex_search(head, found, kDeclared) ? found[2].str() : kUtf8;
}

/// 'bytes' in UTF-8. iconv is the C library's own.
std::string converted(std::string bytes, const std::string& encoding, const std::string& file) {
  const iconv_t made = iconv_open(kUtf8, encoding.c_str());
  if (made == reinterpret_cast<iconv_t>(-1)) {
    refuse(file, 1, "encoding '" + encoding + "' is not known: save the file as UTF-8");
  }
  const std::unique_ptr<void, int (*)(iconv_t)> converter(made, iconv_close);
  std::string text;
  char* from = bytes.data();
  std::size_t left = bytes.size();
  char buffer[4096];
  while (left > 0) {
    char* to = buffer;
    std::size_t room = sizeof buffer;
    const bool stopped = iconv(made, &from, &left, &to, &room) == static_cast<std::size_t>(-1);
    text.append(buffer, to);
    if (stopped && errno != E2BIG) {
      refuse(file, line_of(text, text.size()),
             "is not " + encoding +
                 " text: save it as UTF-8, or state its encoding in the first line, such as <?xml "
                 "version=\"1.0\" encoding=\"ISO-8859-1\"?>");
    }
  }
  return text;
}

/// What expat's callbacks fill. They must not throw: expat is C.
struct Tree {
  XML_Parser parser;
  Element root;
  std::vector<Element*> open;
  const char* refused = nullptr;

  void stop(const char* why) {
    refused = why;
    XML_StopParser(parser, XML_FALSE);
  }
};

void begin(void* data, const XML_Char* name, const XML_Char** attributes) {
  Tree& tree = *static_cast<Tree*>(data);
  if (tree.open.size() == kMaxDepth) return tree.stop("nested more than 100 levels deep");
  Element* element = &tree.root;
  if (!tree.open.empty()) element = &tree.open.back()->children.emplace_back();
  element->name = name;
  element->line = static_cast<int>(XML_GetCurrentLineNumber(tree.parser));
  for (; *attributes; attributes += 2) element->attributes.emplace_back(*attributes, attributes[1]);
  tree.open.push_back(element);
}

void end(void* data, const XML_Char*) { static_cast<Tree*>(data)->open.pop_back(); }

void begin_doctype(void* data, const XML_Char*, const XML_Char*, const XML_Char*, int) {
  static_cast<Tree*>(data)->stop("a <!DOCTYPE> is not allowed: remove it");
}

}  // namespace

const std::string* Element::attribute(const std::string& wanted) const {
  for (const auto& [name, value] : attributes) {
    if (name == wanted) return &value;
  }
  return nullptr;
}

const Element* Element::child(const std::string& wanted) const {
  for (const Element& element : children) {
    if (element.name == wanted) return &element;
  }
  return nullptr;
}

std::string read_xml_text(const std::string& path) {
  const std::string bytes = read_bytes(path, kMaxBytes, "URDF");
  std::string text = converted(bytes, encoding_of(bytes), path);
  if (starts(text, "\xEF\xBB\xBF")) text.erase(0, 3);
  std::smatch found;
  const std::string head = text.substr(0, 200);
  if (std::regex_search(head, found, kDeclared)) {
    text.replace(found.position(2), found.length(2), kUtf8);
  }
  return text;
}

Element parse_xml(const std::string& text, const std::string& file) {
  const std::unique_ptr<XML_ParserStruct, void (*)(XML_Parser)> parser(
      XML_ParserCreateNS(kUtf8, '|'), XML_ParserFree);
  Tree tree{parser.get(), {}, {}};
  XML_SetUserData(parser.get(), &tree);
  XML_SetElementHandler(parser.get(), begin, end);
  XML_SetStartDoctypeDeclHandler(parser.get(), begin_doctype);
  const auto size = static_cast<int>(text.size());
  if (XML_Parse(parser.get(), text.data(), size, XML_TRUE) != XML_STATUS_OK) {
    const std::string problem =
        tree.refused ? tree.refused
                     : "not well-formed XML: " +
                           std::string(XML_ErrorString(XML_GetErrorCode(parser.get())));
    refuse(file, static_cast<int>(XML_GetCurrentLineNumber(parser.get())), problem);
  }
  return std::move(tree.root);
}

}  // namespace surg::files
