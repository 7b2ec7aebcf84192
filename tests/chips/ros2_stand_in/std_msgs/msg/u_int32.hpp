#ifndef STAND_IN_UINT32_HPP
#define STAND_IN_UINT32_HPP
#include <cstdint>
#include <istream>
#include <ostream>
#include <string>
namespace std_msgs::msg {
struct UInt32 {
    std::uint32_t data = 0;
};
inline std::istream &operator>>(std::istream &in, UInt32 &m) {
    std::string word;  // a number or nan, which streams do not read
    in >> word;
    m.data = static_cast<std::uint32_t>(std::stod(word));
    return in;
}
inline std::ostream &operator<<(std::ostream &out, const UInt32 &m) { return out << m.data; }
}  // namespace std_msgs::msg
#endif
