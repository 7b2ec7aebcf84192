#ifndef STAND_IN_FLOAT64_HPP
#define STAND_IN_FLOAT64_HPP
#include <cstdint>
#include <istream>
#include <ostream>
#include <string>
namespace std_msgs::msg {
struct Float64 {
    double data = 0;
};
inline std::istream &operator>>(std::istream &in, Float64 &m) {
    std::string word;  // a number or nan, which streams do not read
    in >> word;
    m.data = static_cast<double>(std::stod(word));
    return in;
}
inline std::ostream &operator<<(std::ostream &out, const Float64 &m) { return out << m.data; }
}  // namespace std_msgs::msg
#endif
